//! A short list of at most `N` values with a known largest encoding.

use core::ops::{Deref, DerefMut};
use postcard::experimental::max_size::MaxSize;
use serde::{Deserialize, Serialize};

/// At most `N` values, stored inline; on the wire a length and the values.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(bound(
    serialize = "T: Serialize",
    deserialize = "T: serde::de::DeserializeOwned"
))]
pub struct List<T, const N: usize>(heapless::Vec<T, N>);

/// One value for each cable of a board, cable 1 first.
pub type PerCable<T> = List<T, { crate::MAX_CABLES }>;

impl<T, const N: usize> List<T, N> {
    /// An empty list.
    #[must_use]
    pub const fn new() -> Self {
        Self(heapless::Vec::new())
    }

    /// Appends a value.
    ///
    /// # Errors
    /// Returns the value when the list is full.
    pub fn push(&mut self, value: T) -> Result<(), T> {
        self.0.push(value)
    }

    /// Removes every value.
    pub fn clear(&mut self) {
        self.0.clear();
    }

    /// Collects at most `N` values; what is over is left in the iterator.
    pub fn collect(values: impl IntoIterator<Item = T>) -> Self {
        let mut list = Self::new();
        for value in values.into_iter().take(N) {
            // Cannot fail: `take` ends at the capacity.
            if list.0.push(value).is_err() {
                break;
            }
        }
        list
    }
}

impl<T, const N: usize> Default for List<T, N> {
    fn default() -> Self {
        Self::new()
    }
}

impl<T, const N: usize> Deref for List<T, N> {
    type Target = [T];
    fn deref(&self) -> &[T] {
        &self.0
    }
}

impl<T, const N: usize> DerefMut for List<T, N> {
    fn deref_mut(&mut self) -> &mut [T] {
        &mut self.0
    }
}

impl<T: MaxSize, const N: usize> MaxSize for List<T, N> {
    // A length under 2^14 takes at most two bytes as a varint.
    const POSTCARD_MAX_SIZE: usize = N * T::POSTCARD_MAX_SIZE + if N < 128 { 1 } else { 2 };
}
