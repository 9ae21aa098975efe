//! Nelder and Mead's simplex: a minimum without derivatives.

/// Nelder and Mead's simplex (1965) in `N` unknowns, from corners `size` away from the start.
pub(super) fn nelder_mead<const N: usize>(
    start: [f64; N],
    size: f64,
    rounds: usize,
    cost: impl Fn(&[f64; N]) -> f64,
) -> [f64; N] {
    let mut simplex: Vec<([f64; N], f64)> = vec![(start, cost(&start))];
    #[expect(clippy::cast_precision_loss, reason = "a few unknowns")]
    let count = N as f64;
    for axis in 0..N {
        let mut corner = start;
        if let Some(value) = corner.get_mut(axis) {
            *value += size;
        }
        simplex.push((corner, cost(&corner)));
    }
    for _ in 0..rounds {
        simplex.sort_by(|a, b| a.1.total_cmp(&b.1));
        let Some((worst, rest)) = simplex.split_last() else {
            return start;
        };
        let (worst, best) = (*worst, rest.first().copied().unwrap_or(*worst));
        let second = rest.last().map_or(worst.1, |corner| corner.1);
        let center: [f64; N] =
            std::array::from_fn(|i| rest.iter().filter_map(|(p, _)| p.get(i)).sum::<f64>() / count);
        let at = |t: f64| -> ([f64; N], f64) {
            let point: [f64; N] = std::array::from_fn(|i| {
                let (c, w) = (center.get(i), worst.0.get(i));
                c.zip(w).map_or(0.0, |(c, w)| c + t * (w - c))
            });
            (point, cost(&point))
        };
        // Reflection, expansion, contraction and shrinking by 1, 2, 1/2 and 1/2, as in the paper.
        let mirrored = at(-1.0);
        let next = if mirrored.1 < best.1 {
            let further = at(-2.0);
            if further.1 < mirrored.1 {
                further
            } else {
                mirrored
            }
        } else if mirrored.1 < second {
            mirrored
        } else {
            at(if mirrored.1 < worst.1 { -0.5 } else { 0.5 })
        };
        if next.1 < worst.1 {
            if let Some(last) = simplex.last_mut() {
                *last = next;
            }
        } else {
            for corner in simplex.iter_mut().skip(1) {
                let point: [f64; N] = std::array::from_fn(|i| {
                    let (a, b) = (best.0.get(i), corner.0.get(i));
                    a.zip(b).map_or(0.0, |(a, b)| 0.5 * (a + b))
                });
                *corner = (point, cost(&point));
            }
        }
    }
    simplex.sort_by(|a, b| a.1.total_cmp(&b.1));
    simplex.first().map_or(start, |best| best.0)
}
