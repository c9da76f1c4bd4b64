//! Colours, and how a shape is filled and stroked.

/// A colour and how much it covers, 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Colour {
    /// Red, green and blue.
    pub rgb: [u8; 3],
    /// 0 where nothing shows.
    pub opacity: f64,
}

impl Colour {
    /// From `0xrrggbb`.
    pub const fn hex(rgb: u32) -> Self {
        Self { rgb: [(rgb >> 16) as u8, (rgb >> 8) as u8, rgb as u8], opacity: 1.0 }
    }

    /// The same, see-through.
    pub const fn faint(self, opacity: f64) -> Self {
        Self { opacity, ..self }
    }

    /// As CSS writes it, without its opacity.
    pub fn css(self) -> String {
        let [r, g, b] = self.rgb;
        format!("#{r:02x}{g:02x}{b:02x}")
    }
}

/// Colour of text and axes.
pub const INK: Colour = Colour::hex(0x46_4a52);
/// The darkest there is.
pub const BLACK: Colour = Colour::hex(0x10_1318);
/// Paper.
pub const WHITE: Colour = Colour::hex(0xff_ffff);

/// How a shape is filled and stroked.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Paint {
    /// Within, where it is filled.
    pub fill: Option<Colour>,
    /// Along its outline, where it is stroked.
    pub stroke: Option<Colour>,
    /// Of the stroke.
    pub width: f64,
    /// Lengths of strokes and gaps in turn; nothing for a full line.
    pub dash: &'static [f64],
    /// Whether strokes end round: a line without length is then a dot.
    pub round: bool,
}

impl Paint {
    /// Filled alone.
    pub fn fill(colour: Colour) -> Self {
        Self { fill: Some(colour), ..Self::default() }
    }

    /// Stroked alone.
    pub fn stroke(colour: Colour, width: f64) -> Self {
        Self { stroke: Some(colour), width, ..Self::default() }
    }

    /// With this outline as well.
    pub fn outlined(self, colour: Colour, width: f64) -> Self {
        Self { stroke: Some(colour), width, ..self }
    }
}
