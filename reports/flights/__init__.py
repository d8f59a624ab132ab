"""Reports of flights: what is wrong with ortho images, orientation, road map, held against the truth."""
