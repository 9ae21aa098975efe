//! The object dictionary of a simulated CiA 402 drive.

use super::nodes::ObjectAddress;
use std::collections::BTreeMap;

/// An object: its size in bytes and its value.
#[derive(Debug, Clone, Copy)]
struct Object {
    size: u8,
    value: u32,
    writable: bool,
}

/// All objects of a drive.
#[derive(Debug, Clone)]
pub(super) struct Objects {
    map: BTreeMap<ObjectAddress, Object>,
}

/// Abort codes of CiA 301.
pub(super) const NO_OBJECT: u32 = 0x0602_0000;
pub(super) const READ_ONLY: u32 = 0x0601_0002;
pub(super) const WRONG_LENGTH: u32 = 0x0607_0010;

impl Objects {
    /// A drive as delivered: node for its identifiers, rated current in mA.
    pub fn new(node: u8, rated_ma: u32) -> Self {
        let node = u32::from(node);
        let mut objects = Self {
            map: BTreeMap::new(),
        };
        let mut add = |index, sub, size, value, writable| {
            let object = Object {
                size,
                value,
                writable,
            };
            objects.map.insert(ObjectAddress { index, sub }, object);
        };
        // Servo drive of profile 402.
        add(0x1000, 0, 4, 0x0002_0192, false);
        add(0x1001, 0, 1, 0, false);
        // The heartbeat that it monitors and the one that it sends (CiA 301); 0 is none.
        add(0x1016, 1, 4, 0, true);
        add(0x1017, 0, 2, 0, true);
        // Predefined connection set of CiA 301: command 0x200 + node, feedback 0x180 + node.
        for (pdo, (command, feedback)) in [(0x200, 0x180), (0x300, 0x280), (0x400, 0x380)]
            .into_iter()
            .enumerate()
        {
            let pdo = pdo as u16;
            add(0x1400 + pdo, 1, 4, command + node, true);
            // 255: by event, not by SYNC.
            add(0x1400 + pdo, 2, 1, 255, true);
            add(0x1800 + pdo, 1, 4, feedback + node, true);
            add(0x1800 + pdo, 2, 1, 255, true);
            for sub in 0..=4 {
                let size = if sub == 0 { 1 } else { 4 };
                add(0x1600 + pdo, sub, size, 0, true);
                add(0x1A00 + pdo, sub, size, 0, true);
            }
        }
        // Abort connection option: 0 nothing, 1 fault, 2 disable voltage. Many drives come with 0.
        add(0x6007, 0, 2, 0, true);
        add(0x6040, 0, 2, 0, true);
        add(0x6041, 0, 2, 0, false);
        add(0x6060, 0, 1, 0, true);
        add(0x6061, 0, 1, 0, false);
        add(0x6064, 0, 4, 0, false);
        // Torques in thousandths of the rated one, as current: 1000 is `rated_ma`.
        add(0x6071, 0, 2, 0, true);
        add(0x6072, 0, 2, 1000, true);
        add(0x6075, 0, 4, rated_ma, false);
        add(0x6077, 0, 2, 0, false);
        add(0x607A, 0, 4, 0, true);
        add(0x6080, 0, 4, 6000, true);
        add(0x60FF, 0, 4, 0, true);
        // Time between two set-points, ms; with 0 each acts at once.
        add(0x60C2, 1, 1, 0, true);
        objects
    }

    /// An object's value; 0 where there is none.
    pub fn get(&self, index: u16, sub: u8) -> u32 {
        self.map
            .get(&ObjectAddress { index, sub })
            .map_or(0, |object| object.value)
    }

    /// The drive itself sets an object.
    pub fn set(&mut self, index: u16, sub: u8, value: u32) {
        if let Some(object) = self.map.get_mut(&ObjectAddress { index, sub }) {
            object.value = value;
        }
    }

    /// Size in bytes and value, for a reader.
    pub fn read(&self, address: ObjectAddress) -> Result<(u8, u32), u32> {
        let object = self.map.get(&address).ok_or(NO_OBJECT)?;
        Ok((object.size, object.value))
    }

    /// A node on the bus writes an object.
    pub fn write(&mut self, address: ObjectAddress, size: u8, value: u32) -> Result<(), u32> {
        let object = self.map.get_mut(&address).ok_or(NO_OBJECT)?;
        if !object.writable {
            return Err(READ_ONLY);
        }
        if object.size != size {
            return Err(WRONG_LENGTH);
        }
        object.value = value;
        Ok(())
    }

    /// A PDO's bytes, packed by its mapping.
    pub fn pack(&self, mapping: u16) -> ([u8; 8], u8) {
        let mut data = [0; 8];
        let mut used = 0_usize;
        for entry in 1..=self.get(mapping, 0) as u8 {
            let entry = self.get(mapping, entry);
            // A mapping entry: index (16 bits), sub-index (8), length in bits (8).
            let (index, sub) = ((entry >> 16) as u16, (entry >> 8) as u8);
            let bytes = self.get(index, sub).to_le_bytes();
            for byte in bytes.into_iter().take((entry & 0xFF) as usize / 8) {
                if used < 8 {
                    data[used] = byte;
                    used += 1;
                }
            }
        }
        (data, used as u8)
    }

    /// Unpacks a PDO's bytes by its mapping; returns whether there were enough.
    pub fn unpack(&mut self, mapping: u16, bytes: &[u8]) -> bool {
        let mut rest = bytes;
        for entry in 1..=self.get(mapping, 0) as u8 {
            let entry = self.get(mapping, entry);
            let (index, sub) = ((entry >> 16) as u16, (entry >> 8) as u8);
            let Some((mine, others)) = rest.split_at_checked((entry & 0xFF) as usize / 8) else {
                return false;
            };
            let mut value = [0; 4];
            value[..mine.len()].copy_from_slice(mine);
            self.set(index, sub, u32::from_le_bytes(value));
            rest = others;
        }
        true
    }
}
