//! Plots as SVG, written without a plotting library. Most of what the page needs is tooltips, colours that follow the
//! reader's light or dark theme, and open marks at the edge for values that a logarithmic axis cannot hold. Colours are
//! classes of the page's style sheet: `s0`, `s1` … fill and stroke.

/// Number of colours, after which they repeat.
pub(super) const COLORS: usize = 10;

/// Number of shapes, after which they repeat.
pub(super) const SHAPES: usize = 6;

/// Points and lines over two logarithmic axes.
#[derive(Debug, Default)]
pub(super) struct Plot {
    pub(super) title: String,
    /// Title of the axis, with its unit.
    pub(super) x_title: String,
    pub(super) y_title: String,
    /// Marked values of x, in place of round numbers.
    pub(super) x_ticks: Option<Vec<f64>>,
    pub(super) lines: Vec<Line>,
    pub(super) marks: Vec<Mark>,
    /// Whether both axes have one range and their diagonal is drawn.
    pub(super) has_diagonal: bool,
}

#[derive(Debug)]
pub(super) struct Line {
    pub(super) points: Vec<(f64, f64)>,
    /// Class of the style sheet for the colour and the dashes.
    pub(super) class: String,
    /// Whether the line goes along the axes: first to the right, then down.
    pub(super) is_stepped: bool,
    pub(super) tip: String,
}

#[derive(Debug)]
pub(super) struct Mark {
    /// Horizontal value. If this value or `y` is at most 0, the mark is drawn open at the edge.
    pub(super) x: f64,
    pub(super) y: f64,
    pub(super) color: usize,
    pub(super) shape: usize,
    pub(super) is_ringed: bool,
    pub(super) tip: String,
}

/// Pixels of the drawing, and of the field between the axes.
const SIZE: (f64, f64) = (460.0, 340.0);
const FIELD: Field = Field { left: 66.0, right: 446.0, top: 34.0, bottom: 290.0 };

struct Field {
    left: f64,
    right: f64,
    top: f64,
    bottom: f64,
}

/// A logarithmic axis.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Axis {
    least: f64,
    most: f64,
    /// Positions of `least` and `most` in the drawing, in pixels.
    ends: (f64, f64),
}

impl Axis {
    /// Returns an axis around the positive values, with some space at both ends and over a factor of 2 at least.
    /// Returns `None` without positive values.
    fn around(values: impl Iterator<Item = f64>, ends: (f64, f64)) -> Option<Self> {
        let positive = values.filter(|value| *value > 0.0 && value.is_finite());
        let (least, most) =
            positive.fold((f64::INFINITY, 0.0_f64), |(least, most), value| (least.min(value), most.max(value)));
        if least > most {
            return None;
        }
        let middle = (least * most).sqrt();
        let half = (most / least).powf(0.5 * 1.16).max(2.0_f64.sqrt());
        Some(Self { least: middle / half, most: middle * half, ends })
    }

    fn place(&self, value: f64) -> f64 {
        let share = (value / self.least).ln() / (self.most / self.least).ln();
        self.ends.0 + share * (self.ends.1 - self.ends.0)
    }

    /// Returns round values to mark: at most eight, and at least three if the range has as many.
    fn ticks(&self) -> Vec<f64> {
        let decades = self.least.log10().floor() as i32..=self.most.log10().ceil() as i32;
        let with = |mantissas: &[f64]| -> Vec<f64> {
            let all = decades
                .clone()
                .flat_map(|decade| mantissas.iter().map(move |mantissa| mantissa * 10.0_f64.powi(decade)));
            all.filter(|tick| (self.least..=self.most).contains(tick)).collect()
        };
        let choices: [&[f64]; 4] = [
            &[1.0],
            &[1.0, 3.0],
            &[1.0, 2.0, 5.0],
            &[1.0, 1.25, 1.5, 1.75, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0],
        ];
        let found = choices.into_iter().map(with).find(|ticks| ticks.len() >= 3);
        let mut ticks =
            found.unwrap_or_else(|| with(&[1.0, 1.25, 1.5, 1.75, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0]));
        while ticks.len() > 8 {
            let mut index = 0..;
            ticks.retain(|_| index.next().is_some_and(|index| index % 2 == 0));
        }
        ticks
    }
}

impl Plot {
    /// Formats the plot as SVG; `None` if nothing can be drawn.
    pub(super) fn svg(&self) -> Option<String> {
        let points = || self.lines.iter().flat_map(|line| &line.points);
        let xs = || {
            points()
                .map(|(x, _)| *x)
                .chain(self.marks.iter().map(|mark| mark.x))
                .chain(self.x_ticks.iter().flatten().copied())
        };
        let ys = || points().map(|(_, y)| *y).chain(self.marks.iter().map(|mark| mark.y));
        let (across, up) = ((FIELD.left, FIELD.right), (FIELD.bottom, FIELD.top));
        let (x_axis, y_axis) = if self.has_diagonal {
            (Axis::around(xs().chain(ys()), across)?, Axis::around(xs().chain(ys()), up)?)
        } else {
            (Axis::around(xs(), across)?, Axis::around(ys(), up)?)
        };

        let mut svg = format!(
            "<svg class=\"plot\" viewBox=\"0 0 {} {}\" role=\"img\"><title>{}</title>\n<text class=\"title\" x=\"{}\" y=\"20\">{}</text>\n",
            SIZE.0,
            SIZE.1,
            escape(&format!("{}: {} over {}", self.title, self.y_title, self.x_title)),
            FIELD.left,
            escape(&self.title)
        );
        svg += &self.grid(&x_axis, &y_axis);
        if self.has_diagonal {
            svg += &format!(
                "<line class=\"diagonal\" x1=\"{}\" y1=\"{}\" x2=\"{}\" y2=\"{}\"/>\n",
                FIELD.left, FIELD.bottom, FIELD.right, FIELD.top
            );
        }
        for line in &self.lines {
            svg += &line.svg(&x_axis, &y_axis);
        }
        for mark in &self.marks {
            svg += &mark.svg(&x_axis, &y_axis);
        }
        Some(svg + "</svg>\n")
    }

    fn grid(&self, x_axis: &Axis, y_axis: &Axis) -> String {
        let Field { left, right, top, bottom } = FIELD;
        let mut svg = String::new();
        for tick in self.x_ticks.clone().unwrap_or_else(|| x_axis.ticks()) {
            let x = x_axis.place(tick);
            svg += &format!("<line class=\"grid\" x1=\"{x:.1}\" y1=\"{top}\" x2=\"{x:.1}\" y2=\"{bottom}\"/>");
            svg += &format!(
                "<text class=\"tick\" text-anchor=\"middle\" x=\"{x:.1}\" y=\"{}\">{}</text>\n",
                bottom + 16.0,
                label(tick)
            );
        }
        for tick in y_axis.ticks() {
            let y = y_axis.place(tick);
            svg += &format!("<line class=\"grid\" x1=\"{left}\" y1=\"{y:.1}\" x2=\"{right}\" y2=\"{y:.1}\"/>");
            svg += &format!(
                "<text class=\"tick\" text-anchor=\"end\" x=\"{}\" y=\"{:.1}\">{}</text>\n",
                left - 6.0,
                y + 4.0,
                label(tick)
            );
        }
        svg += &format!(
            "<rect class=\"field\" x=\"{left}\" y=\"{top}\" width=\"{}\" height=\"{}\"/>\n",
            right - left,
            bottom - top
        );
        let (x_middle, y_middle) = ((left + right) / 2.0, (top + bottom) / 2.0);
        svg += &format!(
            "<text class=\"axis\" text-anchor=\"middle\" x=\"{x_middle}\" y=\"{}\">{}</text>\n",
            bottom + 38.0,
            escape(&self.x_title)
        );
        svg + &format!(
            "<text class=\"axis\" text-anchor=\"middle\" transform=\"translate(14 {y_middle}) rotate(-90)\">{}</text>\n",
            escape(&self.y_title)
        )
    }
}

impl Line {
    fn svg(&self, x_axis: &Axis, y_axis: &Axis) -> String {
        let mut path = String::new();
        for (index, (x, y)) in self.points.iter().filter(|(x, y)| *x > 0.0 && *y > 0.0).enumerate() {
            let (x, y) = (x_axis.place(*x), y_axis.place(*y));
            path += &match (index, self.is_stepped) {
                (0, _) => format!("M{x:.1} {y:.1}"),
                (_, true) => format!("H{x:.1}V{y:.1}"),
                (_, false) => format!("L{x:.1} {y:.1}"),
            };
        }
        format!("<path class=\"line {}\" d=\"{path}\"><title>{}</title></path>\n", self.class, escape(&self.tip))
    }
}

impl Mark {
    fn svg(&self, x_axis: &Axis, y_axis: &Axis) -> String {
        let is_off = self.x <= 0.0 || self.y <= 0.0;
        let x = if self.x > 0.0 { x_axis.place(self.x) } else { FIELD.left };
        let y = if self.y > 0.0 { y_axis.place(self.y) } else { FIELD.bottom };
        let ring = if self.is_ringed {
            format!("<circle class=\"ring\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"9\"/>")
        } else {
            String::new()
        };
        let class = if is_off { "open" } else { "mark" };
        format!(
            "<g class=\"{class} s{}\">{ring}{}<title>{}</title></g>\n",
            self.color % COLORS,
            shape(self.shape, x, y),
            escape(&self.tip)
        )
    }
}

/// Formats a mark of the legend.
pub(super) fn key(color: Option<usize>, shape_index: usize) -> String {
    let class = color.map_or_else(|| "plain".to_owned(), |color| format!("s{}", color % COLORS));
    format!(
        "<svg class=\"key\" viewBox=\"0 0 14 14\"><g class=\"mark {class}\">{}</g></svg>",
        shape(shape_index, 7.0, 7.0)
    )
}

fn shape(index: usize, x: f64, y: f64) -> String {
    let polygon = |corners: &[(f64, f64)]| {
        let corners =
            corners.iter().map(|(dx, dy)| format!("{:.1},{:.1}", x + dx, y + dy)).collect::<Vec<_>>().join(" ");
        format!("<polygon points=\"{corners}\"/>")
    };
    match index % SHAPES {
        0 => format!("<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"4.5\"/>"),
        1 => polygon(&[(-4.2, -4.2), (4.2, -4.2), (4.2, 4.2), (-4.2, 4.2)]),
        2 => polygon(&[(0.0, -5.5), (5.2, 4.0), (-5.2, 4.0)]),
        3 => polygon(&[(0.0, -6.0), (6.0, 0.0), (0.0, 6.0), (-6.0, 0.0)]),
        4 => polygon(&[(0.0, 5.5), (5.2, -4.0), (-5.2, -4.0)]),
        _ => polygon(&[
            (-2.0, -5.5),
            (2.0, -5.5),
            (2.0, -2.0),
            (5.5, -2.0),
            (5.5, 2.0),
            (2.0, 2.0),
            (2.0, 5.5),
            (-2.0, 5.5),
            (-2.0, 2.0),
            (-5.5, 2.0),
            (-5.5, -2.0),
            (-2.0, -2.0),
        ]),
    }
}

/// Horizontal bars, each of parts beside each other, over a linear axis.
#[derive(Debug)]
pub(super) struct Bars {
    pub(super) title: String,
    pub(super) x_title: String,
    pub(super) bars: Vec<Bar>,
}

#[derive(Debug)]
pub(super) struct Bar {
    pub(super) name: String,
    /// Whether space separates the bar from the one above.
    pub(super) begins_group: bool,
    pub(super) parts: Vec<Part>,
}

#[derive(Debug)]
pub(super) struct Part {
    pub(super) value: f64,
    /// Index of the colour; `None` for all parts that have no colour of their own.
    pub(super) color: Option<usize>,
    pub(super) tip: String,
}

impl Bars {
    /// Formats the bars as SVG; `None` if nothing can be drawn.
    pub(super) fn svg(&self) -> Option<String> {
        const ROW: f64 = 22.0;
        const GAP: f64 = 10.0;
        const TOP: f64 = 34.0;
        let sum = |bar: &Bar| bar.parts.iter().map(|part| part.value).sum::<f64>();
        let most = self.bars.iter().map(sum).fold(0.0, f64::max);
        if most <= 0.0 {
            return None;
        }
        let letters = self.bars.iter().map(|bar| bar.name.chars().count()).max().unwrap_or(0);
        let (left, right) = (16.0 + 6.7 * letters as f64, 940.0);
        // The sum stands behind its bar, which leaves room for it.
        let place = |value: f64| left + value / most * (right - 60.0 - left);
        let bottom = TOP + self.bars.iter().map(|bar| if bar.begins_group { ROW + GAP } else { ROW }).sum::<f64>();
        let mut svg = format!(
            "<svg class=\"bars\" viewBox=\"0 0 {right} {}\" role=\"img\"><title>{}</title>\n<text class=\"title\" x=\"{left:.1}\" y=\"20\">{}</text>\n",
            bottom + 44.0,
            escape(&format!("{}: {}", self.title, self.x_title)),
            escape(&self.title)
        );
        for tick in linear_ticks(most) {
            let x = place(tick);
            svg += &format!("<line class=\"grid\" x1=\"{x:.1}\" y1=\"{TOP}\" x2=\"{x:.1}\" y2=\"{bottom}\"/>");
            svg += &format!(
                "<text class=\"tick\" text-anchor=\"middle\" x=\"{x:.1}\" y=\"{}\">{}</text>\n",
                bottom + 16.0,
                label(tick)
            );
        }
        let mut y = TOP;
        for bar in &self.bars {
            y += if bar.begins_group { GAP } else { 0.0 };
            svg += &format!(
                "<text class=\"name\" text-anchor=\"end\" x=\"{:.1}\" y=\"{:.1}\">{}</text>\n",
                left - 8.0,
                y + 15.0,
                escape(&bar.name)
            );
            let mut from = 0.0;
            for part in &bar.parts {
                let class = part.color.map_or_else(|| "plain".to_owned(), |color| format!("s{}", color % COLORS));
                let (x, width) = (place(from), place(part.value) - left);
                svg += &format!(
                    "<rect class=\"part {class}\" x=\"{x:.1}\" y=\"{:.1}\" width=\"{width:.2}\" height=\"{}\"><title>{}</title></rect>\n",
                    y + 3.0,
                    ROW - 6.0,
                    escape(&part.tip)
                );
                from += part.value;
            }
            svg += &format!(
                "<text class=\"tick\" x=\"{:.1}\" y=\"{:.1}\">{}</text>\n",
                place(from) + 6.0,
                y + 15.0,
                label(from)
            );
            y += ROW;
        }
        svg += &format!("<line class=\"base\" x1=\"{left:.1}\" y1=\"{TOP}\" x2=\"{left:.1}\" y2=\"{bottom}\"/>");
        svg += &format!(
            "<text class=\"axis\" text-anchor=\"middle\" x=\"{:.1}\" y=\"{}\">{}</text>\n",
            (left + right) / 2.0,
            bottom + 36.0,
            escape(&self.x_title)
        );
        Some(svg + "</svg>\n")
    }
}

/// Returns 0 and up to six round values.
fn linear_ticks(most: f64) -> Vec<f64> {
    let rough = most / 6.0;
    let power = 10.0_f64.powf(rough.log10().floor());
    let step =
        [1.0, 2.0, 5.0, 10.0].into_iter().map(|factor| factor * power).find(|step| *step >= rough).unwrap_or(rough);
    (0..).map(|index| f64::from(index) * step).take_while(|tick| *tick <= most * 1.0001).collect()
}

/// Formats a number with at most three significant digits: `0.005`, `20`, `12 500`, `3·10⁻⁵`.
pub(super) fn label(value: f64) -> String {
    if value == 0.0 {
        return "0".into();
    }
    let mut power = value.abs().log10().floor() as i32;
    let mut digits = (value / 10.0_f64.powi(power) * 100.0).round() as i64;
    if digits.abs() >= 1000 {
        (digits, power) = (digits / 10, power + 1);
    }
    if (-3..5).contains(&power) {
        let rounded = digits as f64 * 10.0_f64.powi(power - 2);
        let text = format!("{rounded:.*}", usize::try_from(2 - power).unwrap_or(0));
        let text = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
        // Separates groups of three digits in numbers of five digits and more.
        return if power < 4 {
            text.to_owned()
        } else {
            format!("{}\u{2009}{}", &text[..text.len() - 3], &text[text.len() - 3..])
        };
    }
    let mantissa = format!("{:.2}", digits as f64 / 100.0);
    let mantissa = mantissa.trim_end_matches('0').trim_end_matches('.');
    let raised: String = power.to_string().chars().map(raise).collect();
    if mantissa == "1" { format!("10{raised}") } else { format!("{mantissa}·10{raised}") }
}

fn raise(character: char) -> char {
    match character {
        '-' => '⁻',
        '1' => '¹',
        '2' => '²',
        '3' => '³',
        digit => digit.to_digit(10).and_then(|digit| char::from_u32(0x2070 + digit)).unwrap_or(digit),
    }
}

/// Escapes text for HTML and SVG.
pub(super) fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_short() {
        let pairs = [
            (0.0, "0"),
            (1.0, "1"),
            (0.005, "0.005"),
            (0.999_9, "1"),
            (441.0, "441"),
            (12_500.0, "12\u{2009}500"),
            (1681.0, "1680"),
            (3e-5, "3·10⁻⁵"),
            (1e5, "10⁵"),
            (99_990.0, "10⁵"),
            (-0.25, "-0.25"),
        ];
        for (value, text) in pairs {
            assert_eq!(label(value), text);
        }
    }

    #[test]
    fn axes_have_a_few_round_ticks_within_their_range() {
        for (least, most) in [(1.0, 1e7), (3.0, 4.0), (0.002, 0.09), (1e-9, 1e9), (5.0, 5.0), (100.0, 1000.0)] {
            let axis = Axis::around([least, most].into_iter(), (0.0, 1.0));
            assert!(axis.is_some(), "{least} {most}");
            let Some(axis) = axis else { continue };
            let ticks = axis.ticks();
            assert!((2..=8).contains(&ticks.len()), "{least} {most}: {ticks:?}");
            assert!(ticks.iter().all(|tick| (0.0..=1.0).contains(&axis.place(*tick))));
            assert!(axis.place(least) > 0.0 && axis.place(most) < 1.0);
        }
        assert_eq!(Axis::around([0.0, -1.0, f64::NAN].into_iter(), (0.0, 1.0)), None);
        assert_eq!(linear_ticks(5.5), [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]);
    }

    #[test]
    fn marks_at_zero_and_below_stand_open_at_the_edge() {
        let mark = |x, y| Mark { x, y, color: 1, shape: 0, is_ringed: true, tip: "a < b".into() };
        let plot =
            Plot { title: "t".into(), marks: vec![mark(2.0, 1.0), mark(2.0, -3.0), mark(0.0, 1.0)], ..Plot::default() };
        let svg = plot.svg().unwrap_or_default();
        assert!(svg.contains("class=\"open s1\"") && svg.contains("class=\"mark s1\""), "{svg}");
        let at = |x, y| format!("cx=\"{x:.1}\" cy=\"{y:.1}\"");
        let middle = ((FIELD.left + FIELD.right) / 2.0, (FIELD.top + FIELD.bottom) / 2.0);
        assert!(
            svg.contains("a &lt; b")
                && svg.contains(&at(middle.0, FIELD.bottom))
                && svg.contains(&at(FIELD.left, middle.1)),
            "{svg}"
        );
        assert_eq!(Plot::default().svg(), None);
    }
}
