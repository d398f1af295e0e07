"""Labels of markers by a calibrated subject: unlabelled markers, and labels that were exchanged."""
