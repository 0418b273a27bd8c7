"""What keeps the files of strangers from doing harm: names of folders, started Pythons, printed text."""
