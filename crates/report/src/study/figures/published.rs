//! Numbers that the paper on P-WRFGS publishes, for reference beside our own.
//!
//! They belong to the measured spectra of NeRF2 (`s23`), split at random: 4,898 to train on, 1,225 to test, 200,000
//! steps, started from a point cloud of the room. Whether its SSIM is a mean or a median the paper does not say.

/// The paper's numbers for one weight of the mask loss.
pub(super) struct Published {
    /// Gaussians.
    pub(super) gaussians: f64,
    /// SSIM on the test part, where it is given.
    pub(super) ssim: Option<f64>,
    /// Rate ratio at 0 dB, where it is given.
    pub(super) eta: Option<f64>,
}

/// Bian, Hua and Gündüz, "P-WRFGS: Pruning 3D Gaussians for Efficient Wireless Radiance Field Construction", section IV. N of 65,469, 2,613 and 157 is from table I,
/// N of 24 from section IV-B, N of 8 with its two scores from section IV-A; the SSIM at N of 65,469 and 157 is in the
/// source of that section. With the weight 0 it is WRF-GS started from the point cloud. Its figure 2b shows more points
/// without their numbers.
pub(super) const P_WRFGS: [Published; 3] = [
    // weight 0 of the mask loss, 0.02 and 0.04
    Published { gaussians: 65_469.0, ssim: Some(0.899), eta: None },
    Published { gaussians: 157.0, ssim: Some(0.850), eta: None },
    Published { gaussians: 8.0, ssim: Some(0.642), eta: Some(0.9288) },
];
