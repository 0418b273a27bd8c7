"""How bright each photo was taken: what its surroundings and its file tell, and which photos show another light."""
