"""Manual driving: keyboard, gamepad and page, and the session that follows them."""
