//! An STM32F103C8 in the computer that executes the real firmware file.
