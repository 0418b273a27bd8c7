"""The support plane on which an object stands, such as a table: its search, the object's foot, its colors."""
