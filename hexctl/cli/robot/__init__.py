"""Commands about robot files, and about available names."""
