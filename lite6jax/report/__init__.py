"""All sentences, tables, figures and pages, made from codes and numbers."""
