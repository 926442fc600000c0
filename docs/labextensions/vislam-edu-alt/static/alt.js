// JupyterLab draws every PNG with an empty alt. This draws it as JupyterLab does, and takes the alternative text from the
// metadata of the output, where `plots.style` puts it. No build: JupyterLab asks a loaded script for its plugin like this.
(globalThis._JUPYTERLAB ??= {})["vislam-edu-alt"] = {
  init(shared) {
    this.shared = shared;
  },

  async get() {
    const [version] = Object.values(this.shared["@jupyterlab/rendermime"]);
    const { imageRendererFactory } = (await version.get())();
    const createRenderer = (options) => {
      const renderer = imageRendererFactory.createRenderer(options), draw = renderer.renderModel;
      renderer.renderModel = async (model) => {
        await draw.call(renderer, model);
        renderer.node.querySelector("img").alt = model.metadata["image/png"]?.alt ?? "";
      };
      return renderer;
    };
    const rank = imageRendererFactory.defaultRank - 1;
    const rendererFactory = { safe: true, mimeTypes: ["image/png"], createRenderer };
    return () => ({ __esModule: true, default: { id: "vislam-edu-alt:png", dataType: "string", rank, rendererFactory } });
  },
};
