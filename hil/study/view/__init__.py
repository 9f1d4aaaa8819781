"""A log in Rerun, Foxglove, Lichtblick or PlotJuggler: one table of plots, a writer for each viewer."""
