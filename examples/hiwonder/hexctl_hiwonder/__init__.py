"""LX servos behind Hiwonder's STM32 board, as in newer JetHexa and SpiderPi Pro; never tried on a board.

pip install ./examples/hiwonder
hexctl sim board --bus hiwonder --robot ./examples/hiwonder/jethexa-stm32.yaml
"""
