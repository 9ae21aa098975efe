#!/usr/bin/env python3
"""Writes cases.txt: short random instruction sequences with what an independent core (Unicorn,
Cortex-M3 model) makes of them. Seeded, so it always writes the same file.

    pip install unicorn && python3 generate.py > cases.txt

A line: class, seed, flags before (APSR bits 31..27 as hex digits), code (bytes), registers set
beyond what the seed gives; then `>` registers that changed, flags after, RAM words that changed.
Registers and RAM before follow from the seed, see `value`.
"""
import random
import struct
import sys

import unicorn
from unicorn import arm_const as arm

CODE, RAM, BYTES = 0x0800_0000, 0x2000_0000, 0x400
REGS = [getattr(arm, f"UC_ARM_REG_R{n}") for n in range(13)] + [arm.UC_ARM_REG_SP, arm.UC_ARM_REG_LR]
CASES = 5000
MASK = 0xFFFFFFFF


def value(seed, index):
    """What lies in register or RAM word `index` before: Wang's integer mix, some made special."""
    x = (seed * 0x9E3779B9 + index * 0x85EBCA6B + 0x1234567) & MASK
    x = (x ^ (x >> 16)) * 0x7FEB352D & MASK
    x = (x ^ (x >> 15)) * 0x846CA68B & MASK
    x ^= x >> 16
    special = {0: 0, 1: 1, 2: MASK, 3: 0x80000000, 4: 0x7FFFFFFF, 5: x & 31, 6: x & 255, 7: x | 0xFFFF0000}
    return special.get(x >> 8 & 31, x)


def low(r):
    return r.randrange(8)


def gen(r, but=()):
    return r.choice([n for n in [*range(13), 14] if n not in but])


def h(*words):
    return struct.pack(f"<{len(words)}H", *words)


def data_16(r, force=None):
    k = r.randrange(10) if force is None else force
    if k == 0: return h(r.randrange(0x1800))
    if k == 1: return h(0x1800 | r.randrange(0x800))
    if k == 2: return h(0x2000 | r.randrange(0x2000))
    if k in (3, 4, 5): return h(0x4000 | r.randrange(0x400))
    if k == 6:
        rd, rm = gen(r), gen(r)
        return h(0x4400 | r.choice([0, 0x100, 0x200]) | (rd & 8) << 4 | rm << 3 | rd & 7)
    if k == 7: return h(0xB200 | r.randrange(0x100))
    if k == 8: return h(0xBA00 | r.choice([0, 0x40, 0xC0]) | r.randrange(64))
    return h(0xA000 | r.randrange(0x1000))


OPS = [0, 1, 2, 3, 4, 8, 10, 11, 13, 14]


def two(r, rn=None):
    op, s = r.choice(OPS), r.randrange(2)
    rd, rn = gen(r), gen(r)
    if s and op in (0, 4, 8, 13) and r.randrange(4) == 0: rd = 15
    if op in (2, 3) and r.randrange(3) == 0: rn = 15
    return op << 5 | s << 4 | rn, rd


def modified(r):
    a, rd = two(r)
    imm = r.randrange(4096)
    if imm >> 8 in (1, 2, 3) and imm & 255 == 0: imm |= 1
    return h(0xF000 | (imm >> 11) << 10 | a, (imm >> 8 & 7) << 12 | rd << 8 | imm & 255)


def shifted(r):
    a, rd = two(r)
    return h(0xEA00 | a, r.randrange(8) << 12 | rd << 8 | r.randrange(16) << 4 | gen(r))


def plain(r):
    k, rd, rn = r.randrange(8), gen(r), gen(r)
    imm3, imm8, i = r.randrange(8), r.randrange(256), r.randrange(2)
    lo = imm3 << 12 | rd << 8 | imm8
    if k == 0: return h(0xF200 | i << 10 | rn, lo)
    if k == 1: return h(0xF2A0 | i << 10 | rn, lo)
    if k == 2: return h(0xF240 | i << 10 | r.randrange(16), lo)
    if k == 3: return h(0xF2C0 | i << 10 | r.randrange(16), lo)
    lsb = r.randrange(32)
    pos = (lsb >> 2) << 12 | (lsb & 3) << 6 | rd << 8
    if k == 4: return h(r.choice([0xF340, 0xF3C0]) | rn, pos | r.randrange(32 - lsb))
    if k == 5: return h(0xF360 | r.choice([rn, 15]), pos | r.randrange(lsb, 32))
    sh = r.randrange(2) if lsb else 0
    return h(r.choice([0xF300, 0xF380]) | sh << 5 | rn, pos | r.randrange(32))


def register(r):
    rd, rn, rm = gen(r), gen(r), gen(r)
    k = r.randrange(3)
    if k == 0: return h(0xFA00 | r.randrange(8) << 4 | rn, 0xF000 | rd << 8 | rm)
    if k == 1: return h(0xFA0F | r.choice([0, 1, 4, 5]) << 4, 0xF080 | rd << 8 | r.randrange(4) << 4 | rm)
    if r.randrange(3) == 0: return h(0xFAB0 | rm, 0xF080 | rd << 8 | rm)
    return h(0xFA90 | rm, 0xF080 | rd << 8 | r.randrange(4) << 4 | rm)


def multiply(r):
    rd, rn, rm = gen(r), gen(r), gen(r)
    ra = gen(r, (rd,))
    k = r.randrange(9)
    if k == 0: return h(0xFB00 | rn, 0xF000 | rd << 8 | rm)
    if k == 1: return h(0xFB00 | rn, ra << 12 | rd << 8 | rm)
    if k == 2: return h(0xFB00 | rn, ra << 12 | rd << 8 | 0x10 | rm)
    if k < 7: return h(r.choice([0xFB80, 0xFBA0, 0xFBC0, 0xFBE0]) | rn, ra << 12 | rd << 8 | rm)
    return h(r.choice([0xFB90, 0xFBB0]) | rn, 0xF0F0 | rd << 8 | rm)


def it_block(r):
    """One to four instructions under a condition; none of them branches."""
    cond, count = r.randrange(14), r.randrange(1, 5)
    mask = 1 << (4 - count)
    for n in range(count - 1):
        mask |= ((cond ^ r.randrange(2)) & 1) << (3 - n)
    body = [r.choice([data_16, modified, register])(r) for _ in range(count)]
    return h(0xBF00 | cond << 4 | mask) + b"".join(body)


def transfer(r, regs):
    """A load or store; its base lies within the RAM that is looked at."""
    rn = r.randrange(8)
    rt = r.choice([n for n in range(8) if n != rn])
    rm = r.choice([n for n in range(8) if n not in (rn, rt)])
    regs[rn] = RAM + 0x180 + r.randrange(0x80)
    kind = r.randrange(13)
    size = r.choice([0, 1, 2, 8, 9])  # byte, half, word, signed byte, signed half
    load = 1 if size >= 8 else r.randrange(2)
    top = 0xF800 | (size & 8) << 5 | (size & 3) << 5 | load << 4
    if kind == 0: return h(top | 0x80 | rn, rt << 12 | r.randrange(256))
    if kind == 1: return h(top | rn, rt << 12 | r.choice([0x900, 0xB00, 0xC00, 0xD00, 0xF00]) | r.randrange(256))
    if kind == 2:
        regs[rm] = r.randrange(16)
        return h(top | rn, rt << 12 | r.randrange(4) << 4 | rm)
    if kind == 3:
        regs[rm] = r.randrange(64)
        return h(0x5000 | r.randrange(8) << 9 | rm << 6 | rn << 3 | rt)
    if kind == 4: return h(r.choice([0x6000, 0x6800, 0x7000, 0x7800, 0x8000, 0x8800]) | r.randrange(32) << 6 | rn << 3 | rt)
    regs[rn] &= ~3
    if kind == 5: return h(r.choice([0x9000, 0x9800]) | rt << 8 | r.randrange(32))
    if kind == 6:
        rt2 = r.choice([n for n in range(8) if n not in (rn, rt)])
        pu = r.choice([0x0160, 0x0140, 0x01E0, 0x01C0, 0x0060, 0x00E0])
        return h(0xE800 | pu | load << 4 | rn if size < 8 else 0xE950 | rn, rt << 12 | rt2 << 8 | r.randrange(64))
    if kind == 7: return h(r.choice([0xB400, 0xBC00]) | r.randrange(1, 256))
    if kind == 8:
        listed = r.randrange(1, 256)
        if load: return h(0xC800 | rn << 8 | listed)
        return h(0xC000 | rn << 8 | (listed & ~(1 << rn) or 1 << rt))
    if kind == 9:
        listed = (r.randrange(0x2000) & ~(1 << rn)) | 1 << rt | 1 << (8 + rm % 4)
        return h(r.choice([0xE880, 0xE8A0, 0xE900, 0xE920]) | (load << 4 if size < 8 else 0) | rn, listed)
    if kind == 10:
        off = r.randrange(32)
        return h(0xE850 | rn, rt << 12 | 0xF00 | off, 0xE840 | rn, rm << 12 | rt << 8 | off) if rm != rt else h(0xBF00)
    if kind == 11:
        half = r.randrange(2)
        return h(0xE8D0 | rn, rt << 12 | 0xF4F | half << 4, 0xE8C0 | rn, rm << 12 | 0xF40 | half << 4 | rt)
    return h(0xE8C0 | rn, rm << 12 | 0xF40 | rt, 0xF3BF, 0x8F2F)  # store without a reservation


def branch(r, regs):
    """Jumps over one instruction, or not; the instruction adds to a register."""
    skipped = h(0x3001 | low(r) << 8)
    k = r.randrange(4)
    if k == 0: return h(0xD000 | r.randrange(14) << 8) + skipped + h(0xBF00)
    if k == 1: return h(r.choice([0xB100, 0xB900]) | low(r)) + skipped + h(0xBF00)
    if k == 2: return h(0xF000 | r.randrange(14) << 6, 0x8001) + skipped + h(0xBF00)
    return h(0xF000, 0xF801) + skipped + h(0xBF00)


def special(r, regs):
    k = r.randrange(3)
    if k == 0: return h(0xF3EF, 0x8000 | gen(r) << 8)
    if k == 1: return h(0xF380 | gen(r), 0x8800)
    rn = gen(r)
    # Unicorn keeps eight bits of priority, this chip four: the others are masked first.
    return h(0xF000 | rn, 0x00F0 | rn << 8, 0xF380 | rn, 0x8811, 0xF3EF, 0x8011 | gen(r) << 8)


KINDS = {
    "data16": lambda r, g: data_16(r),
    "modified": lambda r, g: modified(r),
    "shifted": lambda r, g: shifted(r),
    "plain": lambda r, g: plain(r),
    "register": lambda r, g: register(r),
    "multiply": lambda r, g: multiply(r),
    "it": lambda r, g: it_block(r),
    "transfer": transfer,
    "branch": branch,
    "special": special,
    "mixed": lambda r, g: b"".join(f(r) for f in r.choices([data_16, modified, shifted, plain, register, multiply], k=4)),
}


def main():
    r = random.Random(20260321)
    kinds = list(KINDS)
    uc = unicorn.Uc(unicorn.UC_ARCH_ARM, unicorn.UC_MODE_THUMB | unicorn.UC_MODE_MCLASS)
    uc.ctl_set_cpu_model(arm.UC_CPU_ARM_CORTEX_M3)
    uc.mem_map(CODE, 0x10000)
    uc.mem_map(RAM, 0x1000)
    kept = 0
    refused = 0
    while kept < CASES:
        kind = kinds[kept % len(kinds)]
        seed, given = r.randrange(1 << 24), {}
        code = KINDS[kind](r, given)
        flags = r.randrange(32)
        before = [value(seed, n) for n in range(15)]
        before[13] = RAM + 0x200
        for n, v in given.items():
            before[n] = v
        ram = struct.pack(f"<{BYTES // 4}I", *(value(seed, 16 + n) for n in range(BYTES // 4)))
        uc.mem_write(CODE, b"\x00\xbf" * 64)
        # A fresh place each time: the translator keeps what it has seen.
        at = CODE + (kept + refused) % 400 * 128
        uc.mem_write(at, code + b"\x00\xbf" * 8)
        uc.ctl_remove_cache(at, at + 64)
        uc.mem_write(RAM, ram)
        for n, v in zip(REGS, before):
            uc.reg_write(n, v)
        uc.reg_write(arm.UC_ARM_REG_XPSR, 0x01000000 | flags << 27)
        uc.reg_write(arm.UC_ARM_REG_BASEPRI, 0)
        try:
            uc.emu_start(at | 1, at + len(code), count=12)
        except unicorn.UcError:
            refused += 1
            continue
        after = [uc.reg_read(n) for n in REGS]
        apsr = uc.reg_read(arm.UC_ARM_REG_XPSR) >> 27
        ram_after = bytes(uc.mem_read(RAM, BYTES))
        changed = [f"{n:x}={v:x}" for n, (b, v) in enumerate(zip(before, after)) if b != v]
        words = [f"@{i:x}={struct.unpack_from('<I', ram_after, i)[0]:x}" for i in range(0, BYTES, 4) if ram[i:i + 4] != ram_after[i:i + 4]]
        start = [f"{n:x}={v:x}" for n, v in sorted(given.items())]
        print(kind, f"{seed:x}", f"{at:x}", f"{flags:x}", code.hex(), *start, ">", f"{apsr:x}", *changed, *words)
        kept += 1
    print(f"{refused} refused", file=sys.stderr)


main()
