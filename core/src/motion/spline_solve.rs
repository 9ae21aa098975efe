//! The knots' velocities of a C2 cubic spline: one tridiagonal system.
//!
//! With h_i the length of segment i and d_i its mean slope, the acceleration has no step at knot i
//! if h_i m_{i-1} + 2 (h_{i-1} + h_i) m_i + h_{i-1} m_{i+1} = 3 (h_i d_{i-1} + h_{i-1} d_i).

use super::spline::Ends;

/// One row of the system: lower, middle, upper, right-hand side.
type Row = [f64; 4];

/// Velocities at the knots; the caller has checked counts, order and finiteness.
pub(super) fn velocities(times: &[f64], values: &[f64], ends: Ends) -> Vec<f64> {
    let steps: Vec<f64> = differences(times);
    let slopes: Vec<f64> = differences(values)
        .iter()
        .zip(&steps)
        .map(|(rise, step)| rise / step)
        .collect();
    let (Some((&h0, _)), Some((&d0, _)), Some((&hn, _)), Some((&dn, _))) = (
        steps.split_first(),
        slopes.split_first(),
        steps.split_last(),
        slopes.split_last(),
    ) else {
        return Vec::new();
    };
    let inner = steps
        .windows(2)
        .zip(slopes.windows(2))
        .map(|(h, d)| match (h, d) {
            ([h0, h1], [d0, d1]) => [*h1, 2.0 * (h0 + h1), *h0, 3.0 * (h1 * d0 + h0 * d1)],
            _ => [0.0, 1.0, 0.0, 0.0],
        });
    let (first, last): (Row, Row) = match ends {
        Ends::Clamped { start, end } => ([0.0, 1.0, 0.0, start], [0.0, 1.0, 0.0, end]),
        // A second derivative of zero: 2 m_0 + m_1 = 3 d_0.
        Ends::Natural => ([0.0, 2.0, 1.0, 3.0 * d0], [1.0, 2.0, 0.0, 3.0 * dn]),
        Ends::NotAKnot => match (&steps[..], &slopes[..]) {
            ([_], [d]) => return vec![*d, *d],
            ([a, b], [da, db]) => {
                // One parabola through three points.
                let bend = (db - da) / (a + b);
                return vec![da - bend * a, da + bend * a, db + bend * b];
            }
            ([_, h1, ..], [_, d1, ..]) => {
                let (h_before, d_before) = match (&steps[..], &slopes[..]) {
                    ([.., h, _], [.., d, _]) => (*h, *d),
                    _ => (*h1, *d1),
                };
                let [middle, upper, right] = not_a_knot(h0, *h1, d0, *d1);
                let [end_middle, end_lower, end_right] = not_a_knot(hn, h_before, dn, d_before);
                (
                    [0.0, middle, upper, right],
                    [end_lower, end_middle, 0.0, end_right],
                )
            }
            _ => return Vec::new(),
        },
        Ends::Periodic => return periodic(inner.collect(), h0, d0, hn, dn),
    };
    let rows: Vec<Row> = std::iter::once(first)
        .chain(inner)
        .chain(std::iter::once(last))
        .collect();
    tridiagonal(&rows)
}

/// Equal third derivatives left and right of the second knot, with the second knot's own row taken
/// off to leave two unknowns: middle, off-diagonal, right-hand side of the end's row.
fn not_a_knot(h0: f64, h1: f64, d0: f64, d1: f64) -> [f64; 3] {
    let both = h0 + h1;
    [
        h1,
        both,
        (d0 * h1 * (h0 + 2.0 * both) + d1 * h0 * h0) / both,
    ]
}

/// The cyclic system: the last knot is the first one. Sherman and Morrison's formula takes the two
/// corner entries off.
fn periodic(inner: Vec<Row>, h0: f64, d0: f64, hn: f64, dn: f64) -> Vec<f64> {
    let mut rows = vec![[h0, 2.0 * (hn + h0), hn, 3.0 * (h0 * dn + hn * d0)]];
    rows.extend(inner);
    let count = rows.len();
    let mut solution = if let [first, second] = rows[..] {
        // Both neighbours of a knot are the other knot.
        let (a, b, c, d) = (
            first[1],
            first[0] + first[2],
            second[0] + second[2],
            second[1],
        );
        let det = a * d - b * c;
        vec![
            (first[3] * d - b * second[3]) / det,
            (a * second[3] - c * first[3]) / det,
        ]
    } else {
        let corner_up = rows.first().map_or(0.0, |row| row[0]);
        let corner_down = rows.last().map_or(0.0, |row| row[2]);
        // This sign doubles the first pivot instead of cancelling it.
        let gamma = -rows.first().map_or(1.0, |row| row[1]);
        if let Some(row) = rows.first_mut() {
            row[1] -= gamma;
        }
        if let Some(row) = rows.last_mut() {
            row[1] -= corner_up * corner_down / gamma;
        }
        let plain = tridiagonal(&rows);
        for (index, row) in rows.iter_mut().enumerate() {
            row[3] = match index {
                0 => gamma,
                _ if index + 1 == count => corner_down,
                _ => 0.0,
            };
        }
        let correction = tridiagonal(&rows);
        let ends = |x: &[f64]| match (x.first(), x.last()) {
            (Some(first), Some(last)) => first + corner_up / gamma * last,
            _ => 0.0,
        };
        let factor = ends(&plain) / (1.0 + ends(&correction));
        plain
            .iter()
            .zip(&correction)
            .map(|(x, z)| x - factor * z)
            .collect()
    };
    if let Some(first) = solution.first().copied() {
        solution.push(first);
    }
    solution
}

/// Thomas's elimination without pivoting: every system here keeps its pivots positive.
fn tridiagonal(rows: &[Row]) -> Vec<f64> {
    let mut reduced: Vec<(f64, f64)> = Vec::with_capacity(rows.len());
    let (mut upper_before, mut right_before) = (0.0, 0.0);
    for [lower, middle, upper, right] in rows {
        let pivot = middle - lower * upper_before;
        (upper_before, right_before) = (upper / pivot, (right - lower * right_before) / pivot);
        reduced.push((upper_before, right_before));
    }
    let mut after = 0.0;
    let mut solution: Vec<f64> = reduced
        .iter()
        .rev()
        .map(|(upper, right)| {
            after = right - upper * after;
            after
        })
        .collect();
    solution.reverse();
    solution
}

fn differences(numbers: &[f64]) -> Vec<f64> {
    numbers
        .windows(2)
        .map(|pair| match pair {
            [a, b] => b - a,
            _ => 0.0,
        })
        .collect()
}
