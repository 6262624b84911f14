"""The Mitsuba integrators ``bdpt`` and ``pssmlt``: pictures of any scene."""
