"""The sessions of a folder as one page: table, filter, sparklines, parallel coordinates."""

from inteco_abs.views.listing.page import check_listing, write_listing

__all__ = ["check_listing", "write_listing"]
