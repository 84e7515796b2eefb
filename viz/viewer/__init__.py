"""The interactive viewer: a page in the browser in which a head is turned by hand."""
