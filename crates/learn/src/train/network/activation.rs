//! What stands between two layers.

use super::Activation;

impl Activation {
    /// In place; `slopes` becomes the derivative.
    pub(super) fn apply(self, values: &mut [f32], slopes: &mut Vec<f32>) {
        slopes.clear();
        slopes.extend(values.iter_mut().map(|v| {
            let z = *v;
            match self {
                Self::Silu => {
                    let gate = 1.0 / (1.0 + (-z).exp());
                    *v = z * gate;
                    gate * (1.0 + z * (1.0 - gate))
                }
                Self::Tanh => {
                    *v = z.tanh();
                    1.0 - *v * *v
                }
                Self::Relu => {
                    *v = z.max(0.0);
                    f32::from(u8::from(z > 0.0))
                }
            }
        }));
    }
}
