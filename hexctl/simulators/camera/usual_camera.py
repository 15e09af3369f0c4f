"""The usual camera of a simulation: light to import."""

#: Flaws of the pictures of a usual webcam: standard deviations of the noise, of 255, and of the blur.
NOISE, BLUR_PX = 4.0, 0.7

#: Position of the camera and the point that it looks at, in m.
POSITION_M, LOOK_AT_M = (-1.63, 0.0, 1.63), (0.0, 0.0, 0.0)
