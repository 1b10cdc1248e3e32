//! `index.html`: one page that needs nothing else, neither files nor a network.

use stein::text::{human_bytes, milliseconds, number};

use super::plot::{Bar, Bars, Line, Mark, Part, Plot, escape, key, label};
use super::statistics::{exponent, front, geometric_mean};
use super::thumbnail::{Gallery, Thumbnail};
use crate::{Configuration, Document, Errors, Result, Row, Set, stage_names};

const STYLE: &str = include_str!("page/style.css");

const RUN_TIME: &str = "wall time, ms";
const RELATIVE_MSE: &str = "relative MSE";

pub(super) fn page(document: &Document, gallery: &Gallery) -> Result<String> {
    let page = Page::new(document);
    let sections = [
        ("time", "Error against run time", page.error_over_time()),
        ("samples", "Error against samples per pixel", page.error_over_samples()),
        ("stages", "Time per stage", page.stages()),
        ("predicted", "Predicted against true error", page.predictions()),
        ("cost", "Cost against pixels and window", page.cost()),
        ("pictures", "Pictures", pictures(&gallery.thumbnails()?)),
        ("figures", "All figures", page.table()),
    ];
    let links: String = sections.iter().map(|(id, title, _)| format!("<a href=\"#{id}\">{title}</a>")).collect();
    let body: String =
        sections.iter().map(|(id, title, content)| format!("<h2 id=\"{id}\">{title}</h2>\n{content}\n")).collect();
    Ok(format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <title>stein bench, {}</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n{}<nav>{links}</nav>\n{body}</body>\n</html>\n",
        escape(&document.date),
        page.head()
    ))
}

/// Data that the sections share: the colour of each series and the shape of each radius.
struct Page<'a> {
    document: &'a Document,
    /// Names of the series; each has a colour.
    series: Vec<&'a str>,
    /// Window radii in pixels; each has a shape. `None` is last.
    radii: Vec<Option<u32>>,
}

impl<'a> Page<'a> {
    fn new(document: &'a Document) -> Self {
        let mut series: Vec<&str> = Vec::new();
        let mut radii: Vec<Option<u32>> = Vec::new();
        for configuration in &document.configurations {
            if !series.contains(&configuration.series.as_str()) {
                series.push(&configuration.series);
            }
            if !radii.contains(&configuration.window_radius()) {
                radii.push(configuration.window_radius());
            }
        }
        radii.sort_by_key(|radius| (radius.is_none(), *radius));
        Self { document, series, radii }
    }

    fn head(&self) -> String {
        let Document { stein, date, arguments, adapter, repeats, sets, configurations, notes, .. } = self.document;
        let scenes = self.scenes().len();
        let facts = [
            ("adapter", format!("{}, {}, {}", adapter.name, adapter.kind, adapter.backend)),
            ("driver", adapter.driver.clone()),
            ("stein", format!("{stein}, {date}")),
            (
                "measured",
                format!(
                    "{} sets of {scenes} scenes, {} configurations, median of {repeats} after a warm-up, in turn",
                    sets.len(),
                    configurations.len()
                ),
            ),
        ];
        let facts: String =
            facts.iter().map(|(name, value)| format!("<dt>{name}</dt><dd>{}</dd>\n", escape(value))).collect();
        let notes: String = notes.iter().map(|note| format!("<dt>note</dt><dd>{}</dd>\n", escape(note))).collect();
        let command = escape(&format!("stein bench {}", shell_words::join(arguments)));
        format!(
            "<h1>Error against run time</h1>\n<dl>\n{facts}<dt>command</dt><dd><code>{command}</code></dd>\n{notes}</dl>\n"
        )
    }

    /// Formats the legend of colours and shapes, for all plots except the plot of the stages.
    fn legend(&self) -> String {
        let colors = self
            .series
            .iter()
            .enumerate()
            .map(|(index, series)| format!("<span>{}{}</span>", key(Some(index), 0), escape(series)));
        let shapes = self.radii.iter().enumerate().map(|(index, radius)| {
            let text = radius.map_or_else(|| "no radius".to_owned(), |radius| format!("R = {radius}"));
            format!("<span>{}{text}</span>", key(None, index))
        });
        let (colors, shapes): (String, String) =
            (colors.collect(), if self.radii.len() > 1 { shapes.collect() } else { String::new() });
        format!("<div class=\"legend\">{colors}{shapes}</div>\n")
    }

    /// Formats `text` and the plots side by side, or only the hint `otherwise` if no plot can be drawn.
    fn panels(&self, text: &str, plots: &[Plot], otherwise: &str) -> String {
        let drawn: Vec<String> = plots.iter().filter_map(Plot::svg).collect();
        if drawn.is_empty() {
            return format!("<p>{otherwise}</p>");
        }
        format!("{text}\n{}<div class=\"panels\">\n{}</div>", self.legend(), drawn.concat())
    }

    fn color(&self, series: &str) -> usize {
        self.series.iter().position(|other| *other == series).unwrap_or(0)
    }

    fn shape(&self, radius: Option<u32>) -> usize {
        self.radii.iter().position(|other| *other == radius).unwrap_or(0)
    }

    fn scenes(&self) -> Vec<&'a str> {
        let mut scenes: Vec<&str> = Vec::new();
        for set in &self.document.sets {
            if !scenes.contains(&set.scene.as_str()) {
                scenes.push(&set.scene);
            }
        }
        scenes
    }

    fn sets_of(&self, scene: &str) -> impl Iterator<Item = &'a Set> {
        self.document.sets.iter().filter(move |set| set.scene == scene)
    }

    fn configurations_of(&self, series: &str) -> impl Iterator<Item = &'a Configuration> {
        self.document.configurations.iter().filter(move |configuration| configuration.series == series)
    }

    fn mark(&self, configuration: &Configuration, (x, y): (f64, f64), is_ringed: bool, tip: String) -> Mark {
        Mark {
            x,
            y,
            color: self.color(&configuration.series),
            shape: self.shape(configuration.window_radius()),
            is_ringed,
            tip,
        }
    }

    /// Makes a plot with a point for each configuration, a line through the points of each series, and the Pareto
    /// front.
    fn contest(&self, title: String, x_title: &str, points: &[(&Configuration, (f64, f64), String)]) -> Plot {
        let on_front = front(&points.iter().map(|(_, point, _)| *point).collect::<Vec<_>>());
        let mut best: Vec<(f64, f64)> =
            points.iter().zip(&on_front).filter(|(_, is_on)| **is_on).map(|((_, point, _), _)| *point).collect();
        best.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut plot = Plot { title, x_title: x_title.into(), y_title: RELATIVE_MSE.into(), ..Plot::default() };
        plot.lines.push(Line {
            points: best,
            class: "front".into(),
            is_stepped: true,
            tip: "Pareto front: nothing is both faster and better".into(),
        });
        for series in &self.series {
            let mut joined: Vec<_> =
                points.iter().filter(|(configuration, ..)| configuration.series == *series).collect();
            joined.sort_by_key(|(configuration, ..)| configuration.window_radius());
            plot.lines.push(self.line(series, joined.iter().map(|(_, point, _)| *point).collect()));
        }
        plot.marks = points
            .iter()
            .zip(on_front)
            .map(|((configuration, point, tip), is_on)| self.mark(configuration, *point, is_on, tip.clone()))
            .collect();
        plot
    }

    fn line(&self, series: &str, points: Vec<(f64, f64)>) -> Line {
        Line {
            points,
            class: format!("s{}", self.color(series) % super::plot::COLORS),
            is_stepped: false,
            tip: series.to_owned(),
        }
    }

    fn error_over_time(&self) -> String {
        let mut plots = Vec::new();
        let with_reference: Vec<&Set> = self.document.sets.iter().filter(|set| set.noisy.is_some()).collect();
        if with_reference.len() > 1 {
            plots.push(self.contest(
                "all sets, geometric mean".into(),
                "wall time, ms per megapixel",
                &self.overall(&with_reference),
            ));
        }
        for set in with_reference {
            let rows = self.document.rows_of(set);
            let points = rows.filter_map(|row| {
                Some((self.document.configuration(row)?, (row.wall_ms, row.relative_mse()?), tip(row)))
            });
            let noisy = set
                .noisy
                .and_then(|noisy| noisy.relative_mse)
                .map_or_else(String::new, |noisy| format!(" (noisy: {})", label(noisy)));
            plots.push(self.contest(format!("{}{noisy}", set.name), RUN_TIME, &points.collect::<Vec<_>>()));
        }
        let text = "<p>Down and to the left is better. Rings mark the Pareto front, where nothing else is both faster and better; lines join the radii of a method. \
                    Stein is timed from the frame in memory to the result in memory, other programs from their start to their end, with their reading and writing.</p>";
        self.panels(text, &plots, "No set has a reference: give one with --ref.")
    }

    /// Returns time and error of each configuration that has an error on every set, as geometric means over the sets.
    fn overall(&self, sets: &[&Set]) -> Vec<(&'a Configuration, (f64, f64), String)> {
        let over = |configuration: &'a Configuration| {
            let rows: Vec<&Row> = sets
                .iter()
                .filter_map(|set| self.document.rows_of(set).find(|row| row.configuration == configuration.name))
                .collect();
            let errors: Vec<f64> = rows.iter().filter_map(|row| row.relative_mse()).collect();
            if errors.len() < sets.len() {
                return None;
            }
            let (time, error) = (
                geometric_mean(&rows.iter().map(|row| row.wall_ms_per_megapixel).collect::<Vec<_>>())?,
                geometric_mean(&errors)?,
            );
            let tip = format!(
                "{}, geometric mean over {} sets\n{} ms per megapixel\nrelative MSE {}",
                configuration.name,
                sets.len(),
                milliseconds(time),
                number(error)
            );
            Some((configuration, (time, error), tip))
        };
        self.document.configurations.iter().filter_map(over).collect()
    }

    fn error_over_samples(&self) -> String {
        let mut plots = Vec::new();
        for scene in self.scenes() {
            // Uses sets at their own sizes only: a resized set is another picture.
            let sets: Vec<(&Set, f64)> = self
                .sets_of(scene)
                .filter(|set| set.noisy.is_some() && !set.is_resized)
                .filter_map(|set| Some((set, set.samples_per_pixel?)))
                .collect();
            let mut ticks: Vec<f64> = sets.iter().map(|(_, samples)| *samples).collect();
            ticks.sort_by(f64::total_cmp);
            ticks.dedup();
            if ticks.len() < 2 {
                continue;
            }
            let mut plot = Plot {
                title: scene.into(),
                x_title: "samples per pixel".into(),
                y_title: RELATIVE_MSE.into(),
                x_ticks: Some(ticks),
                ..Plot::default()
            };
            let mut noisy: Vec<(f64, f64)> =
                sets.iter().filter_map(|(set, samples)| Some((*samples, set.noisy?.relative_mse?))).collect();
            noisy.sort_by(|a, b| a.0.total_cmp(&b.0));
            plot.lines.push(Line { points: noisy, class: "noisy".into(), is_stepped: false, tip: "noisy".into() });
            for configuration in &self.document.configurations {
                let row = |set: &'a Set| self.document.rows_of(set).find(|row| row.configuration == configuration.name);
                let mut found: Vec<(f64, f64, String)> = sets
                    .iter()
                    .filter_map(|(set, samples)| {
                        row(set).and_then(|row| Some((*samples, row.relative_mse()?, tip(row))))
                    })
                    .collect();
                found.sort_by(|a, b| a.0.total_cmp(&b.0));
                plot.lines.push(self.line(&configuration.series, found.iter().map(|(x, y, _)| (*x, *y)).collect()));
                plot.marks.extend(found.into_iter().map(|(x, y, tip)| self.mark(configuration, (x, y), false, tip)));
            }
            plots.push(plot);
        }
        let text = "<p>The dashed line is the input: a method that converges keeps below it.</p>";
        self.panels(text, &plots, "No scene was measured at several numbers of samples per pixel. Sets with the same reference are one scene.")
    }

    fn stages(&self) -> String {
        let names = stage_names(self.document.rows.iter());
        if names.is_empty() {
            return "<p>This adapter cannot time stages.</p>".into();
        }
        // The stages that take most of the time have colours.
        let total = |name: &str| -> f64 {
            self.document
                .rows
                .iter()
                .flat_map(|row| {
                    row.stages.iter().filter(|stage| stage.stage == name).map(move |stage| stage.ms / row.wall_ms)
                })
                .sum()
        };
        let mut by_time: Vec<(&str, f64)> = names.iter().map(|name| (*name, total(name))).collect();
        by_time.sort_by(|a, b| b.1.total_cmp(&a.1));
        let colored: Vec<&str> = by_time.iter().take(super::plot::COLORS).map(|(name, _)| *name).collect();
        let color = |name: &str| colored.iter().position(|other| *other == name);

        let mut legend: String = colored
            .iter()
            .enumerate()
            .map(|(index, name)| format!("<span>{}{}</span>", key(Some(index), 1), escape(name)))
            .collect();
        if names.len() > colored.len() {
            legend += &format!("<span>{}others</span>", key(None, 1));
        }
        let mut content = format!(
            "<p>As the device measures it; the numbers are sums. What runs on the host, and waiting, is not in it.</p>\n<div class=\"legend\">{legend}</div>\n"
        );
        for scene in self.scenes() {
            let timed = |set: &&Set| self.document.rows_of(set).any(|row| !row.stages.is_empty());
            let sets: Vec<&Set> = self.sets_of(scene).filter(timed).collect();
            let most = sets
                .iter()
                .flat_map(|set| self.document.rows_of(set).filter_map(|row| Some(row.device_ms? / set.megapixels())))
                .fold(0.0, f64::max);
            let (unit, unit_ms) = if most < 1e4 { ("ms", 1.0) } else { ("s", 1e3) };
            let mut bars = Bars {
                title: scene.to_owned(),
                x_title: format!("device time, {unit} per megapixel"),
                bars: Vec::new(),
            };
            for (index, set) in sets.into_iter().enumerate() {
                let mut begins_group = index > 0;
                for row in self.document.rows_of(set).filter(|row| !row.stages.is_empty()) {
                    let mut parts: Vec<Part> = Vec::new();
                    for name in names
                        .iter()
                        .filter(|name| color(name).is_some())
                        .chain(names.iter().filter(|name| color(name).is_none()))
                    {
                        let Some(stage) = row.stages.iter().find(|stage| stage.stage == **name) else { continue };
                        let share = 100.0 * stage.ms / row.device_ms.unwrap_or(f64::NAN);
                        let tip = format!(
                            "{}, {}\n{name}: {} ms, {share:.1} %, {} dispatches",
                            row.set,
                            row.configuration,
                            milliseconds(stage.ms),
                            stage.dispatches
                        );
                        parts.push(Part { value: stage.ms / set.megapixels() / unit_ms, color: color(name), tip });
                    }
                    let of_scene =
                        set.name.strip_prefix(scene).map_or(set.name.as_str(), |rest| rest.trim_start_matches(", "));
                    let name = if of_scene.is_empty() {
                        row.configuration.clone()
                    } else {
                        format!("{of_scene}, {}", row.configuration)
                    };
                    bars.bars.push(Bar { name, begins_group, parts });
                    begins_group = false;
                }
            }
            content += &bars.svg().unwrap_or_default();
        }
        content
    }

    fn predictions(&self) -> String {
        let mut plots = Vec::new();
        for scene in self.scenes() {
            let mut plot = Plot {
                title: scene.into(),
                x_title: "true MSE".into(),
                y_title: "predicted MSE".into(),
                has_diagonal: true,
                ..Plot::default()
            };
            for row in self.sets_of(scene).flat_map(|set| self.document.rows_of(set)) {
                if let (Some(predicted), Some(known), Some(configuration)) =
                    (row.predicted_mse, row.errors.and_then(|errors| errors.mse), self.document.configuration(row))
                {
                    plot.marks.push(self.mark(configuration, (known, predicted), false, tip(row)));
                }
            }
            plots.push(plot);
        }
        let text = "<p>Stein's own estimate of its mean squared error, made without the reference. On the diagonal it is right, below it too low; open marks at the lower edge \
                    are estimates of 0. Of nlm it is the variance alone and knows nothing of bias.</p>";
        self.panels(text, &plots, "Nothing was predicted of a set with a reference.")
    }

    fn cost(&self) -> String {
        let mut exponents: Vec<String> = Vec::new();
        // Adds a row for the exponent. Returns whether the points lie far enough apart for an exponent.
        let mut tell = |name: &str, points: &[(f64, f64)], of: &str| {
            let found = exponent(points);
            exponents.extend(
                found.map(|exponent| format!("<tr><td>{}</td><td>{of}</td><td>{exponent:.2}</td></tr>", escape(name))),
            );
            found.is_some()
        };
        let mut pixels = Plot {
            title: "time over pixels".into(),
            x_title: "pixels".into(),
            y_title: RUN_TIME.into(),
            ..Plot::default()
        };
        for configuration in &self.document.configurations {
            let mut rows: Vec<(u64, f64)> = Vec::new();
            for row in self.document.rows.iter().filter(|row| row.configuration == configuration.name) {
                let Some(set) = self.document.set(row) else { continue };
                rows.push((u64::from(set.width) * u64::from(set.height), row.wall_ms));
            }
            let points = means(rows);
            if !tell(&configuration.name, &points, "pixels") {
                continue;
            }
            for &(x, y) in &points {
                let tip = format!("{}\n{x} pixels, {} ms", configuration.name, milliseconds(y));
                pixels.marks.push(self.mark(configuration, (x, y), false, tip));
            }
            pixels.lines.push(self.line(&configuration.series, points));
        }
        let mut window = Plot {
            title: "time over window".into(),
            x_title: "(2R+1)², pixels of the window".into(),
            y_title: "wall time, ms per megapixel".into(),
            ..Plot::default()
        };
        let mut ticks = Vec::new();
        for series in &self.series {
            let mut points = Vec::new();
            for configuration in self.configurations_of(series) {
                let Some(radius) = configuration.window_radius() else { continue };
                let x = f64::from((2 * radius + 1).pow(2));
                let times: Vec<f64> = self
                    .document
                    .rows
                    .iter()
                    .filter(|row| row.configuration == configuration.name)
                    .map(|row| row.wall_ms_per_megapixel)
                    .collect();
                let Some(y) = geometric_mean(&times) else { continue };
                let tip = format!("{}\n{x} pixels, {} ms per megapixel", configuration.name, milliseconds(y));
                points.push((x, y, self.mark(configuration, (x, y), false, tip)));
            }
            points.sort_by(|a, b| a.0.total_cmp(&b.0));
            let line: Vec<(f64, f64)> = points.iter().map(|(x, y, _)| (*x, *y)).collect();
            if !tell(series, &line, "(2R+1)²") {
                continue;
            }
            ticks.extend(points.iter().map(|(x, ..)| *x));
            window.lines.push(self.line(series, line));
            window.marks.extend(points.into_iter().map(|(_, _, mark)| mark));
        }
        ticks.sort_by(f64::total_cmp);
        ticks.dedup();
        window.x_ticks = (!ticks.is_empty()).then_some(ticks);
        let mut content = String::new();
        for (plot, otherwise) in [
            (&pixels, "No sizes of which one has twice the pixels of another were measured: give several with --size."),
            (
                &window,
                "No radii of which one has twice the window of another were measured: give several with --radii.",
            ),
        ] {
            if plot.marks.is_empty() {
                content += &format!("<p>{otherwise}</p>\n");
            }
        }
        content += &self.panels(
            "<p>Where several sets have a size or a radius, their geometric mean.</p>",
            &[pixels, window],
            "",
        );
        if !exponents.is_empty() {
            content += &format!(
                "<h3>Fitted exponents</h3>\n<p>Time grows with this power; 1 is linear.</p>\n<table><thead><tr><th></th><th>with</th><th>exponent</th></tr></thead><tbody>{}</tbody></table>",
                exponents.concat()
            );
        }
        content
    }

    fn table(&self) -> String {
        let head = [
            "",
            "wall ms",
            "ms per megapixel",
            "CPU ms",
            "device ms",
            "first ms",
            "memory",
            RELATIVE_MSE,
            "MSE",
            "SSIM",
            "FLIP",
            "predicted MSE",
        ];
        let head: String = head.iter().map(|name| format!("<th>{name}</th>")).collect();
        let cell = |text: Option<String>| format!("<td>{}</td>", text.unwrap_or_else(|| "–".into()));
        let measures = |errors: Option<Errors>| {
            let get = |value: fn(&Errors) -> Option<f64>| errors.as_ref().and_then(value).map(number);
            [
                cell(get(|errors| errors.relative_mse)),
                cell(get(|errors| errors.mse)),
                cell(get(|errors| errors.ssim)),
                cell(get(|errors| errors.flip)),
            ]
            .concat()
        };
        let mut body = String::new();
        for set in &self.document.sets {
            let file = escape(&format!("{}, {}×{}", stein::text::path(&set.file), set.width, set.height));
            body += &format!(
                "<tr class=\"set\"><th colspan=\"12\">{} <small>{file}</small></th></tr>\n",
                escape(&set.name)
            );
            if set.noisy.is_some() {
                body +=
                    &format!("<tr><td>noisy</td>{}{}{}</tr>\n", cell(None).repeat(6), measures(set.noisy), cell(None));
            }
            for row in self.document.rows_of(set) {
                let class = if row.on_front == Some(true) { " class=\"front\"" } else { "" };
                body += &format!("<tr{class}><td>{}</td>", escape(&row.configuration));
                for text in [
                    Some(milliseconds(row.wall_ms)),
                    Some(milliseconds(row.wall_ms_per_megapixel)),
                    row.cpu_ms.map(milliseconds),
                    row.device_ms.map(milliseconds),
                    Some(milliseconds(row.first_ms)),
                    row.peak_bytes.map(human_bytes),
                ] {
                    body += &cell(text);
                }
                body += &format!("{}{}</tr>\n", measures(row.errors), cell(row.predicted_mse.map(number)));
            }
        }
        format!(
            "<p>Stars: the Pareto front of time and relative MSE. SSIM: 1 is perfect; of the others 0 is. FLIP and SSIM are of the picture as displayed, clamped to [0, 1]. \
             First: the warm-up run, which compiles what no row before it has compiled and no cache holds.</p>\n\
             <div class=\"scroll\"><table><thead><tr>{head}</tr></thead><tbody>\n{body}</tbody></table></div>"
        )
    }
}

/// Returns the geometric mean for each number of pixels, ascending.
fn means(mut rows: Vec<(u64, f64)>) -> Vec<(f64, f64)> {
    rows.sort_by_key(|(pixels, _)| *pixels);
    let groups = rows.chunk_by(|a, b| a.0 == b.0);
    groups
        .filter_map(|group| {
            Some((group[0].0 as f64, geometric_mean(&group.iter().map(|(_, ms)| *ms).collect::<Vec<_>>())?))
        })
        .collect()
}

fn tip(row: &Row) -> String {
    let mut lines = vec![format!("{}, {}", row.set, row.configuration), format!("{} ms", milliseconds(row.wall_ms))];
    lines.extend(row.relative_mse().map(|error| format!("relative MSE {}", number(error))));
    lines.extend(row.errors.and_then(|errors| errors.flip).map(|flip| format!("FLIP {}", number(flip))));
    lines.extend(row.predicted_mse.map(|predicted| format!("predicted MSE {}", number(predicted))));
    lines.extend(row.errors.and_then(|errors| errors.mse).map(|mse| format!("MSE {}", number(mse))));
    lines.join("\n")
}

fn pictures(sets: &[(&str, Vec<Thumbnail>)]) -> String {
    let figure = |thumbnail: &Thumbnail| {
        let Thumbnail { caption, source, extent } = thumbnail;
        let caption = escape(caption);
        format!(
            "<figure><img src=\"{source}\" width=\"{}\" height=\"{}\" alt=\"{caption}\"><figcaption>{caption}</figcaption></figure>\n",
            extent.width, extent.height
        )
    };
    let set = |(name, thumbnails): &(&str, Vec<Thumbnail>)| {
        format!(
            "<h3>{}</h3>\n<div class=\"pictures\">\n{}</div>\n",
            escape(name),
            thumbnails.iter().map(figure).collect::<String>()
        )
    };
    let text = "<p>The input, the results with the least relative MSE, best first, and the reference; clamped to [0, 1] and shown with the curve of sRGB. Large pictures are made \
                smaller, and of many sets some may be left out to keep the page small.</p>\n";
    format!("{text}{}", sets.iter().map(set).collect::<String>())
}
