"""What a finished run is good for: its trained models, put to use on motions and materials of the user's choice.

The commands ``python -m pipeline.generate`` and ``python -m pipeline.dress`` are on top of it.
"""
