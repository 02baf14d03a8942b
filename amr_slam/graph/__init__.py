"""Maps that close: pieces of the way, the loops between them, and the poses that agree with both."""
