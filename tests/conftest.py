"""How long an example of Hypothesis takes says nothing of what is tested: a busy machine makes no test fail.

Beside this, where CI is set, Hypothesis tries the same examples each time.
"""

from hypothesis import HealthCheck, settings

settings.register_profile("patient", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("patient")
