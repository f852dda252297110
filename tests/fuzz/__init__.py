"""Fuzzing of the two readers of `.hmk` files: mutants of valid files, and what Python and TypeScript say of them.

    python -m fuzz --count 200000 --seed 0

`mutants.py` makes them, `python_reader.py` and `viewer/tests/verdicts.ts` read them, each in processes of their own,
`readers.py` watches these, and `campaign.py` keeps what is new and collects findings.
"""
