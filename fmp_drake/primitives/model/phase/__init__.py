"""The phase of a rhythmic movement, and the model that knows it."""
