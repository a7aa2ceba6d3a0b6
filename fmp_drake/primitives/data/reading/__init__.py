"""Reading recordings as people have them: tables, arrays, bags, datasets."""
