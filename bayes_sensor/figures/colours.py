"""The colours and markers of every figure.

Colours are from Okabe and Ito's palette, chosen so that lines also differ in grey.  Important lines
also differ in line style or marker.
"""

INK = "#1b1b1b"
PALE = "#d4d4d4"
MIDDLE = "#7a7a7a"
DATA = "#8fb4d3"
MODEL = "#a01c1c"
BLUE = "#0072b2"
ORANGE = "#d55e00"
GREEN = "#009e73"
REGIONS = ("#dbe8f2", "#a9cae2", "#6fa6cd")
GROUND = "#ffffff"
COLOURS = (GROUND, INK, PALE, MIDDLE, DATA, MODEL, BLUE, ORANGE, GREEN, *REGIONS)
"""every colour in use; the page has a counterpart of each for a dark background"""
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
