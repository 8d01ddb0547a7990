"""A decoder of .clgs files in plain Python and NumPy, made from FORMAT.md and from nothing else.

It is the document as a program: each function names the part that it follows. It imports nothing of
clgs, so this folder can be copied and read by itself; it checks all that the document asks a
decoder to check. It is slow: about a second for 100 anchors.

A test compares it with clgs on whole files, on single streams and on damaged ones. So it shows that
the document suffices, and that clgs reads what the document says. Change it only after the
document: never from the sources of the codec, and never to suit them.

``python -m codec_c.reader FILE.clgs`` prints what a file holds.
"""
