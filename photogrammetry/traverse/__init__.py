"""Where the rover really was: traverses of several solutions, compared and put on the map."""
