"""The node, and what talks to it. Importing it opens files and sockets: none of them may become a standard stream."""

from ..plain import occupy

occupy()
