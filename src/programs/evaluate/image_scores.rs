//! Scores of images, under whatever protocol they were compared.

use serde::{Deserialize, Serialize};

/// Scores of a set of images under one protocol.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ImageScores {
    /// −10·log10 of the mean MSE, dB.
    pub psnr_of_mean_mse: f64,
    /// Mean over images of the PSNR, dB.
    pub mean_psnr: f64,
    /// Mean over images of the structural similarity.
    pub ssim: f64,
    /// Mean over images of the mean squared error.
    pub mse: f64,
    /// Number of images.
    pub images: usize,
}
