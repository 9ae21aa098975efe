//! Copying and clearing memory: the functions that the compiler calls (Run-time ABI for the Arm
//! Architecture, IHI 0043, section 4.3.4). The standard ones are unrolled for any processor, take
//! 1.5 KB of flash, and are not faster for the few words that are copied here.
//!
//! A Cortex-M3 reads and writes single words at any address; pairs (`ldrd`) must be aligned.
#![allow(
    unsafe_code,
    reason = "the compiler names these symbols; in Rust, their loops would be calls of themselves"
)]

use core::arch::global_asm;

global_asm!(
    ".syntax unified",
    ".thumb",
    ".section .text.memory, \"ax\", %progbits",
    // r0 to, r1 from, r2 bytes; pairs of words first.
    ".global __aeabi_memcpy4",
    ".global __aeabi_memcpy8",
    ".thumb_func",
    "__aeabi_memcpy4:",
    ".thumb_func",
    "__aeabi_memcpy8:",
    "mov ip, r0",
    "subs r2, #8",
    "bcc 2f",
    "1: ldrd r0, r3, [r1], #8",
    "strd r0, r3, [ip], #8",
    "subs r2, #8",
    "bcs 1b",
    "2: adds r2, #8",
    "b 3f",
    ".global __aeabi_memcpy",
    ".global memcpy",
    ".thumb_func",
    "__aeabi_memcpy:",
    ".thumb_func",
    // Returns r0 as it was.
    "memcpy:",
    "mov ip, r0",
    "3: subs r2, #4",
    "bcc 5f",
    "4: ldr r3, [r1], #4",
    "str r3, [ip], #4",
    "subs r2, #4",
    "bcs 4b",
    "5: adds r2, #4",
    "beq 7f",
    "6: ldrb r3, [r1], #1",
    "strb r3, [ip], #1",
    "subs r2, #1",
    "bne 6b",
    "7: bx lr",
    // r0 to, r1 bytes, r2 value (of memset alone).
    ".global __aeabi_memclr",
    ".global __aeabi_memclr4",
    ".global __aeabi_memclr8",
    ".thumb_func",
    "__aeabi_memclr:",
    ".thumb_func",
    "__aeabi_memclr4:",
    ".thumb_func",
    "__aeabi_memclr8:",
    "movs r2, #0",
    "subs r1, #4",
    "bcc 9f",
    "8: str r2, [r0], #4",
    "subs r1, #4",
    "bcs 8b",
    "9: adds r1, #4",
    "beq 7b",
    "10: strb r2, [r0], #1",
    "subs r1, #1",
    "bne 10b",
    "bx lr",
);
