//! Independent reference answers that share only the problem statement with the plant.

use crate::plant::{PlantParams, Pose};

type P2 = [f64; 2];

/// Taut length over a wheel by brute force in three steps: the plane is spanned by the axis and
/// the point, the wheel is a polygon of `corners` corners, and the string from far below the
/// entry point, over the wheel, to the point is a chain of the convex hull of all of them.
///
/// Valid while the cable leaves the wheel's far side, that is for points outside the wheel's own
/// shadow, which all test points are.
pub(super) fn hull_length_m(
    b: [f64; 3],
    axis: [f64; 3],
    radius_m: f64,
    point: [f64; 3],
    corners: usize,
) -> f64 {
    let d: Vec<f64> = (0..3).map(|i| point[i] - b[i]).collect();
    let h: f64 = (0..3).map(|i| d[i] * axis[i]).sum();
    let rho = (0..3)
        .map(|i| (d[i] - h * axis[i]).powi(2))
        .sum::<f64>()
        .sqrt();
    // Plane coordinates: x away from the axis, y along it; the wheel's centre at (radius, 0).
    let below = [0.0, -5.0];
    let mut points: Vec<P2> = (0..corners)
        .map(|k| {
            let angle = std::f64::consts::TAU * k as f64 / corners as f64;
            [radius_m - radius_m * angle.cos(), radius_m * angle.sin()]
        })
        .collect();
    points.push(below);
    points.push([rho, h]);
    let hull = convex_hull(points);
    // Counter-clockwise hull: from the point through the wheel's far side to the start below.
    let start = position(&hull, [rho, h]);
    let mut length = 0.0;
    let mut i = start;
    while hull[i] != below {
        let next = (i + 1) % hull.len();
        length += (hull[next][0] - hull[i][0]).hypot(hull[next][1] - hull[i][1]);
        i = next;
    }
    length - 5.0
}

fn position(hull: &[P2], point: P2) -> usize {
    hull.iter()
        .position(|p| *p == point)
        .expect("the point is outside the wheel")
}

/// Convex hull, counter-clockwise (Andrew's monotone chain, 1979).
fn convex_hull(mut points: Vec<P2>) -> Vec<P2> {
    points.sort_by(|a, b| a.partial_cmp(b).expect("finite"));
    let turn = |o: P2, a: P2, b: P2| (a[0] - o[0]) * (b[1] - o[1]) - (a[1] - o[1]) * (b[0] - o[0]);
    let chain = |points: &mut dyn Iterator<Item = P2>| {
        let mut out: Vec<P2> = Vec::new();
        for p in points {
            while out.len() > 1 && turn(out[out.len() - 2], out[out.len() - 1], p) <= 0.0 {
                out.pop();
            }
            out.push(p);
        }
        out.pop();
        out
    };
    let mut hull = chain(&mut points.iter().copied());
    hull.extend(chain(&mut points.iter().rev().copied()));
    hull
}

/// Taut length over a wheel: the wrap angle is found by bisection as the smallest at which the
/// straight part no longer intersects the wheel.
fn taut_length_m(b: [f64; 3], axis: [f64; 3], radius_m: f64, point: [f64; 3]) -> f64 {
    let d: Vec<f64> = (0..3).map(|i| point[i] - b[i]).collect();
    let h: f64 = (0..3).map(|i| d[i] * axis[i]).sum();
    let rho = (0..3)
        .map(|i| (d[i] - h * axis[i]).powi(2))
        .sum::<f64>()
        .sqrt();
    let rest = |w: f64| {
        let (s, c) = w.sin_cos();
        [rho - radius_m + radius_m * c, h - radius_m * s]
    };
    let (mut low, mut high) = (0.0, 1.5 * std::f64::consts::PI);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        let (s, c) = f64::sin_cos(middle);
        let r = rest(middle);
        if -c * r[0] + s * r[1] < 0.0 {
            low = middle;
        } else {
            high = middle;
        }
    }
    let r = rest(low);
    radius_m * low + r[0].hypot(r[1])
}

/// Potential energy of the robot as a function of a pose and of the unstretched lengths.
pub(super) struct Energy<'a> {
    pub robot: &'a PlantParams,
    /// Unstretched cable from drum to attachment (m).
    pub unstretched_m: Vec<f64>,
    /// A drum that hauls in with a constant force (N) instead of being locked.
    pub hauled: Option<(usize, f64)>,
}

impl Energy<'_> {
    /// `q`: position (m), rotation vector (rad), and change of the hauled cable's length (m).
    fn at(&self, q: &[f64; 7]) -> f64 {
        let m = rodrigues([q[3], q[4], q[5]]);
        let world = |p: [f64; 3]| -> [f64; 3] {
            std::array::from_fn(|i| q[i] + (0..3).map(|j| m[i][j] * p[j]).sum::<f64>())
        };
        let platform = &self.robot.platform;
        let com = world(platform.center_of_mass_m);
        let mut energy = -(0..3)
            .map(|i| platform.mass_kg * self.robot.gravity_mps2[i] * com[i])
            .sum::<f64>();
        for (i, cable) in self.robot.cables.iter().enumerate() {
            let mut unstretched = self.unstretched_m[i];
            if let Some((hauled, force_n)) = self.hauled
                && hauled == i
            {
                unstretched += q[6];
                energy += force_n * q[6];
            }
            let point = world(cable.attachment_m);
            let length = taut_length_m(
                cable.anchor_m,
                cable.swivel_axis,
                cable.pulley_radius_m,
                point,
            ) + cable.routing_length_m;
            let stretch = (length - unstretched).max(0.0);
            energy += 0.5 * cable.ea_n * stretch * stretch / unstretched;
        }
        // Without a hauled cable the last coordinate is idle; keep it at 0.
        if self.hauled.is_none() {
            energy + q[6] * q[6]
        } else {
            energy
        }
    }

    /// The pose of least energy near `guess`: Newton's method on numerical derivatives, with a
    /// multiple of the identity added until the step descends.
    pub(super) fn least(&self, guess: &Pose) -> [f64; 7] {
        let w = guess.rotation_wxyz;
        let sine = (w[1] * w[1] + w[2] * w[2] + w[3] * w[3]).sqrt();
        let per = if sine > 1e-12 {
            2.0 * sine.atan2(w[0]) / sine
        } else {
            2.0
        };
        let p = guess.position_m;
        let mut q = [p[0], p[1], p[2], w[1] * per, w[2] * per, w[3] * per, 0.0];
        let mut damping = 1e-6;
        for _ in 0..200 {
            let (gradient, hessian) = self.derivatives(&q);
            let before = self.at(&q);
            let mut moved = 0.0_f64;
            for _ in 0..40 {
                let mut a = hessian;
                for (i, row) in a.iter_mut().enumerate() {
                    row[i] += damping * (1.0 + row[i].abs());
                }
                let step = solve(a, gradient.map(|g| -g));
                let mut next = q;
                next.iter_mut().zip(step).for_each(|(x, s)| *x += s);
                // Below the noise of the energy itself any small step is as good.
                if self.at(&next) <= before + 1e-13 {
                    moved = step.iter().fold(0.0, |m, s| m.max(s.abs()));
                    q = next;
                    damping = (damping * 0.1).max(1e-12);
                    break;
                }
                damping = (damping * 10.0).max(1e-9);
            }
            if moved < 1e-10 {
                break;
            }
        }
        q
    }

    fn derivatives(&self, q: &[f64; 7]) -> ([f64; 7], [[f64; 7]; 7]) {
        let h = 2e-5;
        let shifted = |moves: &[(usize, f64)]| {
            let mut x = *q;
            for (i, by) in moves {
                x[*i] += by;
            }
            self.at(&x)
        };
        let gradient =
            std::array::from_fn(|i| (shifted(&[(i, h)]) - shifted(&[(i, -h)])) / (2.0 * h));
        let hessian = std::array::from_fn(|i| {
            std::array::from_fn(|j| {
                (shifted(&[(i, h), (j, h)])
                    - shifted(&[(i, h), (j, -h)])
                    - shifted(&[(i, -h), (j, h)])
                    + shifted(&[(i, -h), (j, -h)]))
                    / (4.0 * h * h)
            })
        });
        (gradient, hessian)
    }
}

fn rodrigues(r: [f64; 3]) -> [[f64; 3]; 3] {
    let angle = r.iter().map(|v| v * v).sum::<f64>().sqrt();
    let (a, b) = if angle < 1e-9 {
        (1.0, 0.5)
    } else {
        (angle.sin() / angle, (1.0 - angle.cos()) / (angle * angle))
    };
    let k = [[0.0, -r[2], r[1]], [r[2], 0.0, -r[0]], [-r[1], r[0], 0.0]];
    std::array::from_fn(|i| {
        std::array::from_fn(|j| {
            let square: f64 = (0..3).map(|l| k[i][l] * k[l][j]).sum();
            f64::from(u8::from(i == j)) + a * k[i][j] + b * square
        })
    })
}

/// Gaussian elimination with row pivoting.
fn solve(mut a: [[f64; 7]; 7], mut b: [f64; 7]) -> [f64; 7] {
    for column in 0..7 {
        let pivot = (column..7)
            .max_by(|i, j| a[*i][column].abs().total_cmp(&a[*j][column].abs()))
            .expect("rows");
        a.swap(column, pivot);
        b.swap(column, pivot);
        for row in column + 1..7 {
            let factor = a[row][column] / a[column][column];
            let upper = a[column];
            a[row]
                .iter_mut()
                .zip(upper)
                .for_each(|(x, u)| *x -= factor * u);
            b[row] -= factor * b[column];
        }
    }
    let mut x = [0.0; 7];
    for row in (0..7).rev() {
        let known: f64 = (row + 1..7).map(|k| a[row][k] * x[k]).sum();
        x[row] = (b[row] - known) / a[row][row];
    }
    x
}

/// Position and matrix of `q` as [`Energy::least`] returns it.
pub(super) fn pose_of(q: &[f64; 7]) -> Pose {
    Pose::from_matrix([q[0], q[1], q[2]], &rodrigues([q[3], q[4], q[5]])).expect("a rotation")
}
