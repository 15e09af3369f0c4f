"""What this computer has and what works on it, for bug reports: `hexctl.doctor.checkup.doctor()`."""
