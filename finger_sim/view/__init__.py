"""A page in the browser that shows the finger and holds it; see docs/view.md.

`protocol` says what is sent, `hub` to whom, `server` how; a source (`live`, `playback`) says what there is to show.
"""
