"""Maps that close: pieces of the way, loops between them, poses that agree with both."""
