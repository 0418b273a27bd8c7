"""One module for each format of photo files, and how the values in a file become linear radiance."""
