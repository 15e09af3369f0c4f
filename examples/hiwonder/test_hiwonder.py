"""The family keeps the promises of a servo driver, on its own simulated board."""

from hexctl.testing import BusFamilyConformance


class TestHiwonder(BusFamilyConformance):
    driver = "hiwonder"
    model = "hts35h"
