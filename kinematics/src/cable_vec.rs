//! Per-cable results whose number of entries is known at run time, without allocation.

use core::fmt;
use core::ops::{Deref, DerefMut, Index, IndexMut};

/// The largest number of cables of a robot in this crate.
/// One bit each in the `u16` of [`CableSet`].
pub const MAX_CABLES: usize = 16;

/// One value per cable, in cable order (index 0 is cable 1). Dereferences to a slice.
#[derive(Clone, Copy)]
pub struct CableVec<T> {
    items: [T; MAX_CABLES],
    len: usize,
}

impl<T: Copy + Default> CableVec<T> {
    /// `len` default values. Lengths above [`MAX_CABLES`] are cut to it.
    pub fn filled(len: usize) -> Self {
        Self {
            items: [T::default(); MAX_CABLES],
            len: len.min(MAX_CABLES),
        }
    }

    /// A copy of a slice; `None` above [`MAX_CABLES`] entries.
    pub fn from_slice(values: &[T]) -> Option<Self> {
        if values.len() > MAX_CABLES {
            return None;
        }
        let mut out = Self::filled(values.len());
        out.copy_from_slice(values);
        Some(out)
    }

    /// One value per index, from a function of the zero-based cable index.
    pub fn from_fn(len: usize, mut f: impl FnMut(usize) -> T) -> Self {
        let mut out = Self::filled(len);
        for i in 0..out.len {
            out.items[i] = f(i);
        }
        out
    }
}

impl<T: fmt::Debug> fmt::Debug for CableVec<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list().entries(self.iter()).finish()
    }
}

impl<T: PartialEq> PartialEq for CableVec<T> {
    fn eq(&self, other: &Self) -> bool {
        **self == **other
    }
}

impl<T> Deref for CableVec<T> {
    type Target = [T];
    fn deref(&self) -> &[T] {
        &self.items[..self.len]
    }
}

impl<T> DerefMut for CableVec<T> {
    fn deref_mut(&mut self) -> &mut [T] {
        &mut self.items[..self.len]
    }
}

impl<'a, T> IntoIterator for &'a CableVec<T> {
    type Item = &'a T;
    type IntoIter = core::slice::Iter<'a, T>;
    fn into_iter(self) -> Self::IntoIter {
        self.iter()
    }
}

/// A square matrix with one row and one column per cable (row-major, run-time size).
#[derive(Clone, Copy, PartialEq)]
pub struct CableMatrix {
    data: [[f64; MAX_CABLES]; MAX_CABLES],
    n: usize,
}

impl CableMatrix {
    /// The `n` by `n` zero matrix; `n` above [`MAX_CABLES`] is cut to it.
    pub fn zeros(n: usize) -> Self {
        Self {
            data: [[0.0; MAX_CABLES]; MAX_CABLES],
            n: n.min(MAX_CABLES),
        }
    }

    /// Number of rows (and columns).
    pub fn size(&self) -> usize {
        self.n
    }

    /// Row of one cable (zero-based), or `None` beyond the last.
    pub fn row(&self, cable: usize) -> Option<&[f64]> {
        self.data[..self.n].get(cable).map(|r| &r[..self.n])
    }
}

impl fmt::Debug for CableMatrix {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let rows = self.data[..self.n].iter().map(|r| &r[..self.n]);
        f.debug_list().entries(rows).finish()
    }
}

impl Index<(usize, usize)> for CableMatrix {
    type Output = f64;
    fn index(&self, (i, j): (usize, usize)) -> &f64 {
        &self.data[..self.n][i][..self.n][j]
    }
}

impl IndexMut<(usize, usize)> for CableMatrix {
    fn index_mut(&mut self, (i, j): (usize, usize)) -> &mut f64 {
        &mut self.data[..self.n][i][..self.n][j]
    }
}

/// A set of cables, as bits (bit 0 is cable 1).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CableSet(u16);

impl CableSet {
    /// Adds a cable by its zero-based index (indices above 15 are ignored).
    pub fn insert(&mut self, cable: usize) {
        if cable < MAX_CABLES {
            self.0 |= 1 << cable;
        }
    }

    /// Whether the cable with this zero-based index is in the set.
    pub fn contains(self, cable: usize) -> bool {
        cable < MAX_CABLES && self.0 & (1 << cable) != 0
    }

    /// Whether no cable is in the set.
    pub fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Number of cables in the set.
    pub fn len(self) -> usize {
        self.0.count_ones() as usize
    }

    /// Zero-based indices of the cables in the set, ascending.
    pub fn iter(self) -> impl Iterator<Item = usize> {
        (0..MAX_CABLES).filter(move |&i| self.contains(i))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cable_vec_is_a_slice_of_its_length() {
        let v = CableVec::from_fn(5, |i| i as f64);
        assert_eq!(v.len(), 5);
        assert_eq!(&v[3..], &[3.0, 4.0]);
        assert_eq!(CableVec::from_slice(&[0.0; 17]), None);
    }

    #[test]
    fn a_cable_set_lists_its_members() {
        let mut s = CableSet::default();
        s.insert(3);
        s.insert(0);
        s.insert(40);
        assert_eq!(s.len(), 2);
        assert!(s.contains(3) && !s.contains(1) && !s.contains(40));
        assert!(s.iter().eq([0, 3]));
    }
}
