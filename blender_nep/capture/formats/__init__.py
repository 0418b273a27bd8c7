"""The forms that a capture on disk may have, one file each.

A format has two functions: `recognizes(folder)` says whether the folder is of this form, and `read(folder)` gives a
`CaptureDescription`, or raises CaptureError. `capture/loading.py` asks the formats in turn, and checks what
is common to all.
"""
