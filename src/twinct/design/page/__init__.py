"""The page of ``twinct design``: the page of ``twinct view``, with tools that change its scenario.

Each folder and tab of the page is a file. The tools are a thin layer: browsers ask, one thread
changes the model and paints what it says.
"""

from twinct.design.page.design_page import DesignPage

__all__ = ["DesignPage"]
