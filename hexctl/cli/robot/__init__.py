"""Commands about robot files, available names, and this computer."""
