"""A log in Rerun, Foxglove, Lichtblick and PlotJuggler: one table of panels, a writer for each viewer."""
