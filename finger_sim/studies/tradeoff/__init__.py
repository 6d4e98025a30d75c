"""What does each setting cost, and what does it give up?"""
