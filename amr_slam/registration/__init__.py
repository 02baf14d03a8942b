"""Point set registration, one file a method."""
