"""The paper's experiments: landscapes of all gaits, convergence of all optimizers, one report.

`hexctl.study.planned_study` plans what options ask for; `hexctl.study.study` runs it.
"""
