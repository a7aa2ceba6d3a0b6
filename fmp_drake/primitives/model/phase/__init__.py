"""Phase of a rhythmic movement, and its model."""
