//! Which pixels are dark, by a threshold that follows the light.

use crate::image::{GrayImage, Image};

/// Side of the squares whose extremes decide, px.
/// The cells of the smallest tag, 20 px wide, have 2.5 px.
const TILE_PX: usize = 4;

/// 1 where a pixel is darker than the middle between the extremes of the tiles around it, 0 where
/// it is brighter or where these tiles have less contrast than `contrast_min`.
pub(super) fn dark(picture: &GrayImage, contrast_min: f64) -> Image<u8> {
    let (width, height) = (picture.width(), picture.height());
    let across = width.div_ceil(TILE_PX);
    let down = height.div_ceil(TILE_PX);
    let (mut low, mut high) = (vec![255_u8; across * down], vec![0_u8; across * down]);
    for y in 0..height {
        let start = y / TILE_PX * across;
        let tiles = low[start..start + across]
            .iter_mut()
            .zip(&mut high[start..start + across]);
        for ((low, high), pixels) in tiles.zip(picture.row(y).chunks(TILE_PX)) {
            for &pixel in pixels {
                *low = (*low).min(pixel);
                *high = (*high).max(pixel);
            }
        }
    }
    let low = spread(&low, across, u8::min);
    let high = spread(&high, across, u8::max);
    let mut dark = Image::filled(width, height, 0_u8);
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    let contrast_min = contrast_min.clamp(0.0, 255.0) as u8;
    // A pixel is dark where it is at most its tile's limit; 0 marks a tile without contrast (a
    // black pixel there is lost, which such a tile can afford).
    let limits: Vec<u8> = low
        .iter()
        .zip(&high)
        .map(|(&low, &high)| {
            if high - low < contrast_min {
                0
            } else {
                // Halved first: the sum would not fit into a byte.
                (low / 2 + high / 2).max(1)
            }
        })
        .collect();
    for y in 0..height {
        let start = y / TILE_PX * across;
        let row = &mut dark.pixels_mut()[y * width..(y + 1) * width];
        let tiles = row.chunks_mut(TILE_PX).zip(picture.row(y).chunks(TILE_PX));
        for ((out, pixels), &limit) in tiles.zip(&limits[start..start + across]) {
            for (out, &pixel) in out.iter_mut().zip(pixels) {
                *out = u8::from(pixel < limit);
            }
        }
    }
    dark
}

/// The extreme of each tile and its eight neighbours.
fn spread(tiles: &[u8], across: usize, pick: fn(u8, u8) -> u8) -> Vec<u8> {
    let rows: Vec<u8> = tiles
        .chunks(across)
        .flat_map(|row| {
            (0..across).map(move |x| {
                let left = row[x.saturating_sub(1)];
                let right = row[(x + 1).min(across - 1)];
                pick(pick(left, right), row[x])
            })
        })
        .collect();
    let down = rows.len() / across;
    (0..rows.len())
        .map(|i| {
            let (x, y) = (i % across, i / across);
            let above = rows[y.saturating_sub(1) * across + x];
            let below = rows[(y + 1).min(down - 1) * across + x];
            pick(pick(above, below), rows[i])
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_dark_square_on_a_ramp_of_light_is_found_and_flat_areas_are_not() {
        let mut picture = GrayImage::filled(64, 32, 0);
        for y in 0..32 {
            for x in 0..64 {
                let light = 100 + 2 * x;
                let grey = if (20..40).contains(&x) && (8..24).contains(&y) {
                    light / 4
                } else {
                    light
                };
                picture.set(x, y, u8::try_from(grey).unwrap());
            }
        }
        let dark = dark(&picture, 30.0);
        assert_eq!(dark.get(20, 8), Some(1));
        assert_eq!(dark.get(39, 23), Some(1));
        assert_eq!(dark.get(19, 8), Some(0));
        assert_eq!(dark.get(60, 4), Some(0));
    }
}
