"""Search for a straight gait with a custom optimizer: one that tries all gaits, from the last to the first.

Run it with `python examples/own_optimizer.py`, or `hexctl adapt --optimizer own_optimizer:Backwards`.
"""

import hexctl


class Backwards(hexctl.Optimizer):
    """Tries all codes from the last to the first, again and again."""

    name = "backwards"
    _next = 0

    def _suggest(self, count):
        return [self.space.size - (self._next + index) % self.space.size for index in range(count)]

    def _learn(self, codes, scores):
        self._next += len(codes)

    def _search_state(self):
        return {"next": self._next}

    def _restore_search(self, state):
        self._next = state["next"]


if __name__ == "__main__":
    found = hexctl.adapt(failed_leg=5, optimizer=Backwards, budget=4, duration_s=5, record=False)
    print(f"gait {found.best.code} ends {100 * found.best.score:.1f} cm off its line")
