"""From a recorded voice to a performance: what is said, when, and what a face does that says it.

``request``    what is asked
``sound``      samples of a file, and how loud they are
``spelling``   words that the dictionary lacks
``listening``  utterances and their phones (PocketSphinx)
``mouth``      lips and jaw that form these phones
``acting``     what the rest of the face and the head do meanwhile
``api``        all of it in one call
"""
