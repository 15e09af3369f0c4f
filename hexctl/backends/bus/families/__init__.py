"""Families of bus servos: their models, their registers or commands, and their buses."""
