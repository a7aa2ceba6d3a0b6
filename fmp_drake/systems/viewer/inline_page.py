"""A page of Meshcat inside a notebook."""

from html import escape


class InlinePage:
    """A saved page that a notebook, or a gallery of examples, shows below its cell.

    The page is a part of the notebook: it can be turned and replayed without a server.

    Parameters
    ----------
    html : str
        The page, as `Meshcat.StaticHtml` or `WipingRun.html` returns it.
    height : int
        Pixels.

    Examples
    --------
    >>> page = InlinePage("<p>nothing to see</p>", height=50)
    >>> print(page._repr_html_())
    <iframe class="replay" title="replay" width="100%" height="50"
    srcdoc="&lt;p&gt;nothing to see&lt;/p&gt;"></iframe>
    """

    def __init__(self, html: str, *, height: int = 400) -> None:
        self._html = html
        self._height = height

    def __repr__(self) -> str:
        """Return what is shown where there is no page."""
        return f"InlinePage of {len(self._html) / 1e6:.1f} MB"

    def _repr_html_(self) -> str:
        """Return what IPython shows."""
        return (
            f'<iframe class="replay" title="replay" width="100%" height="{self._height}"\n'
            f'srcdoc="{escape(self._html)}"></iframe>'
        )
