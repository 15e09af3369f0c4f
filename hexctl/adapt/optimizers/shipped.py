"""The optimizers that come with hexctl, by name: light to import, for the Tab key."""

#: The optimizers that come with hexctl and need no prior: their classes in this package, or the cores of
#: populations.
OPTIMIZERS = {
    "pso": "population:ParticleSwarm",
    "psosp": "population:SpeciatedSwarm",
    "dps": "population:DifferentialSwarm",
    "debest": "population:BestEvolution",
    "derand": "population:RandomEvolution",
    "random": "baselines:RandomSearch",
    "exhaustive": "baselines:ExhaustiveSearch",
}

#: Those that only `hexctl.adapt.sessions.session_optimizer` makes: they need a prior, the strides that the
#: servos of a robot hold, or its ranked gaits.
BAYES, STRIDES, TRIM = "bayes", "strides", "trim"

OF_SESSIONS = {BAYES: "bayes:Bayes", STRIDES: "strides:StrideSearch", TRIM: "trim:TrimSearch"}

#: Names of all optimizers that come with hexctl.
NAMES = (*OF_SESSIONS, *OPTIMIZERS)
