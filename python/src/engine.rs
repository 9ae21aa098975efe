//! Physics of others, called from Python.

use mcdpr_simulator::plant::{Foreign, Hanging, MAX_CABLES, Pose};
use pyo3::prelude::*;

/// A Python object that is called with paid-out lengths (m), their rates (m/s) and a duration (s),
/// and gives position (m), quaternion w x y z and tensions (N).
pub(crate) struct Engine(pub(crate) Py<PyAny>);

impl Foreign for Engine {
    fn advance(
        &mut self,
        paid_out_m: &[f64],
        rates_mps: &[f64],
        duration_s: f64,
    ) -> Result<Hanging, String> {
        let said = Python::attach(|py| {
            let arguments = (paid_out_m.to_vec(), rates_mps.to_vec(), duration_s);
            let said = self.0.bind(py).call1(arguments)?;
            said.extract::<([f64; 3], [f64; 4], Vec<f64>)>()
        });
        let (position_m, rotation_wxyz, tensions) = said.map_err(|error| error.to_string())?;
        let length = rotation_wxyz.iter().map(|x| x * x).sum::<f64>();
        if tensions.len() != paid_out_m.len() || (length - 1.0).abs() > 1e-6 {
            return Err(format!(
                "it gave {} tensions for {} cables and a quaternion of square length {length}",
                tensions.len(),
                paid_out_m.len()
            ));
        }
        let mut tensions_n = [0.0; MAX_CABLES];
        for (slot, tension) in tensions_n.iter_mut().zip(tensions) {
            *slot = tension;
        }
        Ok(Hanging {
            pose: Pose {
                position_m,
                rotation_wxyz,
            },
            tensions_n,
        })
    }
}
