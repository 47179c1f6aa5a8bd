// Plotly in the page's own colours, loaded once from the installed wheel.

let loading = null;

export function plotly() {
  if (!loading) {
    loading = new Promise((resolve, reject) => {
      const script = document.createElement("script");
      script.src = "/dashboard/plotly.min.js";
      script.onload = () => resolve(window.Plotly);
      script.onerror = () => reject(new Error("plotly.js did not load"));
      document.head.append(script);
    });
  }
  return loading;
}

export const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

export function layout(more = {}) {
  const axis = { gridcolor: colour("line"), zerolinecolor: colour("dim"), linecolor: colour("line"), tickfont: { size: 11 }, automargin: true };
  const { xaxis = {}, yaxis = {}, ...rest } = more;
  return {
    paper_bgcolor: "rgba(0,0,0,0)",
    plot_bgcolor: "rgba(0,0,0,0)",
    font: { color: colour("ink"), size: 12, family: "system-ui, sans-serif" },
    margin: { l: 56, r: 10, t: 8, b: 32 },
    showlegend: false,
    xaxis: { ...axis, ...xaxis },
    yaxis: { ...axis, ...yaxis },
    ...rest,
  };
}

export const CONFIG = { staticPlot: true, responsive: true, displayModeBar: false };

export async function draw(place, traces, more) {
  const library = await plotly();
  if (place.isConnected && place.clientWidth > 0) await library.react(place, traces, layout(more), CONFIG);
}
