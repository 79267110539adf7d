"""Files of models, of studies and of others: text to checked SI numbers, to models and back."""
