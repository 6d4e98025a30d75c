"""Does the finger's force fade as a fingertip's does?"""
