"""Forward model of a contact fringe-projection sensor."""
