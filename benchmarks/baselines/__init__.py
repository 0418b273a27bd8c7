"""What the method is compared with: the published fields and path, and a peer, Mitsuba."""
