"""Experiments with many simulated walks, and the priors and repertoires that such walks make.

`hexctl.study.planned_study` and `hexctl.study.priors.planned_prior` plan what options ask for.
"""
