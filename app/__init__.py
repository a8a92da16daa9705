"""The authoring app: a finished run's garments shaped by hand, in a browser.

``session`` is what is being made and knows no browser; ``window`` puts it on a page of ``viser``. The command
``python -m pipeline.app`` starts it.
"""
