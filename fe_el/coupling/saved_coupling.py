"""What a checkpoint keeps of a coupling."""
from typing import Any

import numpy as np


class SavedCoupling:
    """State of :class:`Coupling` between two steps; what belongs to particles is kept with them."""

    fields: tuple[Any, ...]
    answers: bool | None
    over_filled_total: int
    particles: Any
    smoothing: Any
    near: Any
    linear: Any
    _kept: tuple[Any, ...] | None
    _mapped: tuple[Any, ...] | None

    def saved(self) -> dict[str, tuple]:
        """Whether the fluid answers, the count of over-filled cells, the number of fields, and the cells that the smoothing
        serves, for a checkpoint."""
        answers, cells = -1 if self.answers is None else int(self.answers), self.particles.cells
        mask, steps = (np.zeros(cells.owned), -1) if self.near is None else (self.near.mask.astype(float), self.near.steps)
        return {"same": (None, {"answers": answers, "over_filled_total": self.over_filled_total, "fields": len(self.fields),
                                "steps_of_smoothing": steps}),
                "cells": (cells.corner[:cells.owned].mean(1), {"smoothed": mask})}

    def restore(self, state: dict[str, dict]) -> None:
        """Take them back.

        Raises:
            ValueError: for the state of a coupling with other fields.
        """
        before = int(state["same"].get("fields", len(self.fields)))
        if (before > 3) != (len(self.fields) > 3):  # older files know four
            raise ValueError(f"The coupling in the checkpoint has {before} fields, this one {len(self.fields)}; give the "
                             f"same forces, with PressureGradient(at_end={before > 3}) if they hold no AddedMass.")
        answers = int(state["same"]["answers"])
        self.answers = None if answers < 0 else bool(answers)
        self.over_filled_total, self._kept, self._mapped = int(state["same"]["over_filled_total"]), None, None
        steps, self.near = int(state["same"].get("steps_of_smoothing", -1)), None
        if steps >= 0 and hasattr(self.smoothing, "near") and self.linear is None:
            self.near = self.smoothing.near(np.asarray(state["cells"]["smoothed"]) > 0)
            self.near.steps = steps
