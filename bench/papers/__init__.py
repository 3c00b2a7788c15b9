"""The figures and tables of [BP17], [PP12], [RHR08] and [RRH07] that synthetic images allow, drawn and measured anew.

``python -m bench.papers [NAME ...]`` (``make papers``) draws all, or those of the named chapters, a module each here,
and brings docs/papers.md up to date: pictures, and tables that show each number beside the paper's.
"""
