"""Published data sets of real people: their layouts read, their labels understood, captures made of them."""
