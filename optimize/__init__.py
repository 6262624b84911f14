"""Color and direction search, reports, verification and the command line.

Rooms import each other one way. Low to high: ``design``, ``scoring``, ``readers``, ``search``,
``exploration``, ``verification``, ``robust``, ``report``, ``frontier``, ``overnight``, ``cli``.
``ui`` stands at the side: every room may tell its user something, and ``ui`` knows none of them.
"""
