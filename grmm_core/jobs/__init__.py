"""Work that takes a while: what it says of itself while it runs.

``progress``  the record `Progress`, the `Reporter` that makes it, the estimate of the time left
``beside``    work on a thread of its own, beside other work
``stages``    the stages of every kind of work: names, labels for people, their shares of the time

Fits, captures, trainings, evaluations, exports and installations report through here; the command line's console and
Blender's panels draw what they report. Needs the standard library only.
"""
