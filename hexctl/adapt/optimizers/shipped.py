"""The optimizers that come with hexctl, by name: light to import, for the Tab key."""

#: Cores of searches with a population, in the module `population`.
POPULATIONS = {
    "pso": "ParticleSwarm",
    "psosp": "SpeciatedSwarm",
    "dps": "DifferentialSwarm",
    "debest": "BestEvolution",
    "derand": "RandomEvolution",
}

#: Optimizers in the module `baselines`.
BASELINES = {"random": "RandomSearch", "exhaustive": "ExhaustiveSearch"}

#: Names of the optimizers that need no prior.
OPTIMIZERS = (*POPULATIONS, *BASELINES)

#: Those that only `hexctl.adapt.sessions.session_optimizer` makes: they need a prior, the strides that the
#: servos of a robot hold, or its ranked gaits.
BAYES, STRIDES, TRIM = "bayes", "strides", "trim"

#: Their classes, in this package.
OF_SESSIONS = {BAYES: "bayes:Bayes", STRIDES: "strides:StrideSearch", TRIM: "trim:TrimSearch"}

#: Names of all optimizers that come with hexctl.
NAMES = (*OF_SESSIONS, *OPTIMIZERS)
