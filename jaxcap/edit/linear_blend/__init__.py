"""Convert bodies for programs and files that support only linear blend skinning."""
