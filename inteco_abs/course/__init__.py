"""Exercises for a course: submissions run in a process of their own, on rigs that are drawn from a secret seed.

`grading` is the way in; `student` is what runs in that process, and imports none of the rest.
"""
