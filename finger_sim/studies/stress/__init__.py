"""Does anything break at the extremes?"""
