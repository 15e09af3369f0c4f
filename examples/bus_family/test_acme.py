"""The family keeps the promises of a servo driver, on its own simulated bus."""

from hexctl.testing import BusFamilyConformance


class TestAcme(BusFamilyConformance):
    driver = "acme"
