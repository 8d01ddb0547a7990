"""A decoder of .clgs files in plain Python, written from codec_c/FORMAT.md and from nothing else.

It shows that the document suffices, and that clgs reads what the document says. So it must be
changed only from the document: never from the source code of the codec, nor to suit it.
"""
