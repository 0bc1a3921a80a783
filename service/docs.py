"""`/docs`: Swagger UI over the OpenAPI description, without the internet, which machines seldom reach.

The framework's default page loads Swagger UI from a public address; its files come from the package
`fastapi-offline` here.
"""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from fastapi import FastAPI
from fastapi.openapi.docs import get_swagger_ui_html
from starlette.responses import HTMLResponse
from starlette.staticfiles import StaticFiles

SCRIPT, STYLE, ICON = "swagger-ui-bundle.js", "swagger-ui.css", "favicon.png"


def install(app: FastAPI) -> None:
    """Serve `/docs` and its files."""
    assets = Path(str(files("fastapi_offline") / "static"))
    app.mount("/docs/assets", StaticFiles(directory=assets), name="assets")

    @app.get("/docs", include_in_schema=False)
    async def docs() -> HTMLResponse:
        return get_swagger_ui_html(
            openapi_url="/openapi.json",
            title=app.title,
            swagger_js_url=f"/docs/assets/{SCRIPT}",
            swagger_css_url=f"/docs/assets/{STYLE}",
            swagger_favicon_url=f"/docs/assets/{ICON}",
        )
