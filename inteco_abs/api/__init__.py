"""The Python interface, offered by `import inteco_abs`, and what the command's verbs have in common with it.

Loads nothing: each part is imported when a script, a notebook or a verb uses it.
"""
