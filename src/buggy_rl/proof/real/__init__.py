"""Effects concealed in recordings of real cars, and real changes that are known."""
