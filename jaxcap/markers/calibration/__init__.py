"""All poses, joint centres and places of markers together."""
