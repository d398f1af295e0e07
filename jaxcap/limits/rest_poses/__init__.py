"""Rest poses of skeletons: how they differ, and limits from one to another."""
