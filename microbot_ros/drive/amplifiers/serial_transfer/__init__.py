"""SerialTransfer: packets of Arduino, Teensy and ESP32 firmware, over one serial line."""
