"""Programs of a rig, each in a process of its own: twin, board, controller, trials, relay, viewer, flood."""
