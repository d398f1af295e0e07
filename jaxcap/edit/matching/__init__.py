"""Find the joints of two skeletons that are the same joint of a person, by their names and by their trees."""
