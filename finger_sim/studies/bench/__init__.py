"""How fast is a step, and next to other simulators?"""
