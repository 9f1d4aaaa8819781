"""`hil view`: shows a log in Rerun, Foxglove, Lichtblick or PlotJuggler with prepared plots."""
