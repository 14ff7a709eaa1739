"""Figures that a notebook shows by themselves."""

import io

from matplotlib.figure import Figure


class Drawing(Figure):
    """A figure; as the last value of a notebook's cell it is shown."""

    def _repr_png_(self) -> bytes:
        out = io.BytesIO()
        self.savefig(out, format="png", dpi=100)
        return out.getvalue()
