"""The optimizers that come with hexctl, by name: light to import, for the Tab key and the help."""

#: Optimizers that need a space and a seed only: module in this package, and class.
OPTIMIZERS = {
    "pso": "population:SwarmSearch",
    "psosp": "population:SpeciatedSearch",
    "dps": "population:DifferentialSearch",
    "debest": "population:BestEvolutionSearch",
    "derand": "population:RandomEvolutionSearch",
    "random": "baselines:RandomSearch",
    "exhaustive": "baselines:ExhaustiveSearch",
}

#: Those that only `hexctl.adapt.sessions.session_optimizer` makes: they need a prior, the strides that the
#: servos of a robot hold, or its ranked gaits.
BAYES, STRIDES, TRIM = "bayes", "strides", "trim"

#: Their modules and classes.
OF_SESSIONS = {BAYES: "bayes:Bayes", STRIDES: "strides:StrideSearch", TRIM: "trim:TrimSearch"}

#: Names of all optimizers that come with hexctl.
NAMES = (*OF_SESSIONS, *OPTIMIZERS)
