"""Studies of localization that anyone can rerun: ``python tools/evaluate.py``.

Each study is a module with ``run(effort) -> Section``; :mod:`amr_slam.studies.report` puts the
sections into one page.
"""
