"""Judge how well a posed body explains a cloud, by part, against what a sequence shows to be normal."""
