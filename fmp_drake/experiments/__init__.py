"""`fmp-drake reproduce`: section V of the paper, on recordings of one's own."""
