"""Operators: one moves the joints of limp servos by hand, one watches joints that motors move."""

import re
from collections.abc import Callable

import numpy as np

from hexctl.types import JOINT_NAMES, FloatArray

#: True angles of the ends to which joints are moved, in degrees.
ENDS_DEG = (-92.0, 60.0)


class Person:
    """A scripted operator, by parts of questions, with all text shown."""

    def __init__(self, script: dict[str, list[str]]) -> None:
        self.screen: list[str] = []
        self._script, self._question, self._polls = script, "", 0

    def tell(self, text: str) -> None:
        self.screen.append(text)

    def prompt(self, text: str) -> None:
        self.screen.append(text)
        self._question, self._polls = text, 0


class Hands(Person):
    """Reads what is asked, poses the legs so, and answers.

    Args:
        hold: puts joints at true angles (18,) in degrees.
        script: answers in place of Enter, by part of the question, each used once; `quit` and `skip` move
            nothing, `#` raises `interrupted` instead of an answer.

    Attributes:
        true_deg: where the joints are.
        interrupted: whether Ctrl-C was pressed.
    """

    def __init__(self, hold: Callable[[FloatArray], None], **script: list[str]) -> None:
        super().__init__(script)
        self._hold, self.interrupted = hold, False
        self.true_deg: FloatArray = np.linspace(-12, 14, 18)  # as the legs hang
        hold(self.true_deg)

    def poll(self) -> str | None:
        self._polls += 1
        if self._polls < 3 or self.interrupted:
            return None
        for part, answers in self._script.items():
            if part in self._question.replace(" ", "_") and answers:
                answer = answers.pop(0)
                self.interrupted = answer == "#"
                if answer in ("skip", "quit", "#"):
                    return None if self.interrupted else answer
                if answer:
                    return answer
        self._obey(self._question)
        return ""

    def _obey(self, question: str) -> None:
        """Move what the question, and the lines before it, ask to be moved."""
        if posed := re.search(r"leg (\d) is in it", question):
            leg = int(posed[1])
            for kind in ("coxa", "femur", "tibia"):
                angles = [re.match(rf"  {kind} (\S+) deg:", line) for line in self.screen]
                self.true_deg[JOINT_NAMES.index(f"leg{leg}_{kind}")] = float([a for a in angles if a][-1][1])
        elif any(words in question for words in ("far as it may", "10 deg or more", "hold it anywhere")):
            joint = self._joint()
            rises = "counter-clockwise" in question or " up" in question
            if "10 deg" in question:
                self.true_deg[joint] += 15 if rises else -15
            elif "far as" in question:
                self.true_deg[joint] = ENDS_DEG[rises]
        self._hold(self.true_deg)

    def _joint(self) -> int:
        """The joint that is asked about."""
        named = [line.split(",")[0] for line in self.screen if line.split(",")[0] in JOINT_NAMES]
        return JOINT_NAMES.index(named[-1])


class Watcher(Person):
    """Sees the true angle of a joint that motors move, and judges its direction and angle.

    Args:
        true_deg: where the joint is now.
        good_deg: how near to the angle that is asked for it has to be.
        patience: polls before an answer, in which the last step is on its way.
        script: answers by part of the question, each used once.
    """

    def __init__(
        self, true_deg: Callable[[], float], good_deg: float = 0.2, patience: int = 0, **script: list[str]
    ) -> None:
        super().__init__(script)
        self._true_deg, self._good_deg, self._patience = true_deg, good_deg, patience
        self._before_deg = 0.0

    def poll(self) -> str | None:
        self._polls += 1
        if not self._question or self._polls <= self._patience:
            return None
        question, self._question = self._question, ""
        for part, answers in self._script.items():
            if part in question and answers:
                return answers.pop(0)
        if "Enter to move it" in question:
            self._before_deg = self._true_deg()
        if "did it move" in question:
            rises = " counter-clockwise" in question or " up" in question
            return "yes" if (self._true_deg() > self._before_deg) == rises else "no"
        if "if you measured" in question:
            asked = re.findall(r"turn it to (\S+) deg", "\n".join(self.screen))[-1]
            missing_deg = float(asked) - self._true_deg()
            return "ok" if abs(missing_deg) < self._good_deg else f"{np.clip(missing_deg, -40, 40):.2f}"
        return "skip" if "travel" in question else ""
