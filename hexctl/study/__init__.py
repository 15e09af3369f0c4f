"""The paper's experiments: landscapes of all gaits, convergence of all optimizers, one report.

`hexctl.study.study.study(folder="report")` runs them.
"""
