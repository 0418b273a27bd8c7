"""The pixels of all photos as rays: sets of pixels, and where they are kept."""
