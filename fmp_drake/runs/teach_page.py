"""The buttons and the line of text of a teaching session's page."""

from collections.abc import Sequence

from pydrake.geometry import Meshcat


class TeachPage:
    """Buttons that are pressed once, and a line of text, in Meshcat's own controls.

    Parameters
    ----------
    meshcat : Meshcat

    Examples
    --------
    >>> page = TeachPage(Meshcat())
    >>> page.show(("learn", "again"), "drag the eraser")
    >>> page.clicked() is None
    True
    """

    def __init__(self, meshcat: Meshcat) -> None:
        self._meshcat = meshcat
        self._clicks: dict[str, int] = {}
        self._text = ""

    def show(self, names: Sequence[str], text: str) -> None:
        """Show these buttons, in this order, above a line of text."""
        if [*self._clicks] != [*names]:
            self.delete()
            for name in names:
                self._meshcat.AddButton(name)
            self._clicks = dict.fromkeys(names, 0)
        if text != self._text:
            # Meshcat writes no text but on its controls.
            self._meshcat.DeleteButton(self._text, strict=False)
            self._text = text
            self._meshcat.AddButton(text)

    def clicked(self) -> str | None:
        """Return a button that was clicked since the last question, or None."""
        for name, before in self._clicks.items():
            now = self._meshcat.GetButtonClicks(name)
            if now != before:
                self._clicks[name] = now
                return name
        return None

    def delete(self) -> None:
        """Remove everything from the page."""
        for name in (*self._clicks, self._text):
            self._meshcat.DeleteButton(name, strict=False)
        self._clicks, self._text = {}, ""
