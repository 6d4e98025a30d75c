"""Are the paper's experiments reproduced?"""
