"""State of this computer for bug reports: `hexctl.doctor.checkup.doctor()`."""
