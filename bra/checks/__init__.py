"""What people hand over is looked at once, and told of in one clear line.

A line says what, what was expected, what was given, and a way out.
"""
