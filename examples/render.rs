//! Renders a custom cloud and differentiates a pixel with respect to the centres of the Gaussians:
//! `cargo run --release -p pwrfgs --example render -- [PICTURE.png]`.
#![allow(clippy::print_stdout)] // example program

use pwrfgs::prelude::*;
use pwrfgs::raster::{AlphaBlending, Mercator};

/// Creates two Gaussians about 3 m above a receiver that faces up; the rear one is partly visible.
fn cloud() -> Primitives {
    Primitives {
        means: vec![[1.5, 1.0, 2.4], [1.2, 1.8, 2.5]],
        scales: vec![[0.5, 0.3, 0.3], [0.3, 0.3, 0.6]],
        quats: vec![[1.0, 0.0, 0.0, 0.0], [0.9, 0.3, 0.3, 0.1]],
        opacities: vec![0.9, 0.6],
    }
}

/// Signals of the Gaussians: real and imaginary part.
const SIGNALS: [Real; 4] = [1.0, 0.3, -0.2, 0.7];
const CHANNELS: usize = 2;

/// Renders a cloud; returns its splats, the blended signals and the image of magnitudes.
fn draw(cloud: &Primitives, plane: &ImagePlane) -> (Splats, Render, Image) {
    let splats = Mercator::default().project(cloud, &Pose::IDENTITY, plane);
    let render = AlphaBlending::default().forward(splats.with_signals(&SIGNALS, CHANNELS, plane));
    let pixels = Readout::Magnitude.forward(&render.pixels, plane.width * plane.height);
    let image = Image { width: plane.width, height: plane.height, pixels };
    (splats, render, image)
}

fn main() {
    let (projector, rasterizer) = (Mercator::default(), AlphaBlending::default());
    let plane = projector.plane(360, 90);
    let (splats, render, image) = draw(&cloud(), &plane);
    let out = std::env::args().nth(1).unwrap_or_else(|| "render.png".into());
    image::save_buffer(&out, &image.to_bytes(), 360, 90, image::ExtendedColorType::L8).expect("a folder to write to");

    // A pixel next to the strongest pixel, where the spectrum is steep: cotangent 1, all others 0.
    let pixel = image.argmax() + 6;
    let mut d_image = vec![0.0; image.pixels.len()];
    d_image[pixel] = 1.0;
    let d_pixels = Readout::Magnitude.vjp(&render.pixels, d_image.len(), &d_image);
    let d = rasterizer.backward(splats.with_signals(&SIGNALS, CHANNELS, &plane), &render, &d_pixels);
    let d_cloud = projector.project_vjp(&cloud(), &Pose::IDENTITY, &plane, &splats, &d.splats);

    println!("{out}: pixel {pixel} is {:.4}", image.pixels[pixel]);
    for (i, d) in d_cloud.means.iter().enumerate() {
        let mut moved = cloud();
        moved.means[i][0] += 0.005;
        let up = draw(&moved, &plane).2.pixels[pixel];
        moved.means[i][0] -= 0.010;
        let difference = (up - draw(&moved, &plane).2.pixels[pixel]) / 0.010;
        println!("Gaussian {i}: d pixel / d x = {:.4} per metre, by finite difference {difference:.4}", d[0]);
    }
}
