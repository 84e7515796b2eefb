"""Pictures: orbits, sheets, panels and their files."""
