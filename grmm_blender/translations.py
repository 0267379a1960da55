"""Translations of labels into German, French, Spanish, Simplified Chinese and Japanese.

One row for each message of panels and operators; Blender shows the column of the user's language and the English text where a
message is missing. Names of expressions stay English, as ARKit has them.
"""

from __future__ import annotations

import bpy

LOCALES = ("de_DE", "fr_FR", "es", "zh_HANS", "ja_JP")
CONTEXTS = ("*", "Operator")
"""Blender looks labels of operators up in a context of their own."""

MESSAGES: dict[str, tuple[str, str, str, str, str]] = {
    "Add GRMM Head": (
        "GRMM-Kopf hinzufügen", "Ajouter une tête GRMM", "Añadir cabeza GRMM",
        "添加 GRMM 头部", "GRMM ヘッドを追加",
    ),
    "Add FLAME Head": (
        "FLAME-Kopf hinzufügen", "Ajouter une tête FLAME", "Añadir cabeza FLAME",
        "添加 FLAME 头部", "FLAME ヘッドを追加",
    ),
    "Add Random Person": (
        "Zufällige Person hinzufügen", "Ajouter une personne aléatoire", "Añadir persona aleatoria",
        "添加随机人物", "ランダムな人物を追加",
    ),
    "Open GRMM Avatar": (
        "GRMM-Avatar öffnen", "Ouvrir un avatar GRMM", "Abrir avatar GRMM",
        "打开 GRMM 化身", "GRMM アバターを開く",
    ),
    "Open Avatar...": ("Avatar öffnen ...", "Ouvrir un avatar...", "Abrir avatar...", "打开化身...", "アバターを開く..."),
    "Avatar": ("Avatar", "Avatar", "Avatar", "化身", "アバター"),
    "Avatars": ("Avatare", "Avatars", "Avatares", "化身", "アバター"),
    "Person": ("Person", "Personne", "Persona", "人物", "人物"),
    "Source": ("Quelle", "Source", "Origen", "来源", "ソース"),
    "Expression": ("Ausdruck", "Expression", "Expresión", "表情", "表情"),
    "Pose": ("Pose", "Pose", "Pose", "姿态", "ポーズ"),
    "Identity": ("Identität", "Identité", "Identidad", "身份", "アイデンティティ"),
    "Learned Detail": ("Gelernte Details", "Détail appris", "Detalle aprendido", "学习到的细节", "学習されたディテール"),
    "Learned Detail on Mesh": (
        "Gelernte Details auf dem Mesh", "Détail appris sur le maillage", "Detalle aprendido en la malla",
        "网格上的学习细节", "メッシュ上の学習ディテール",
    ),
    "Also During Playback": (
        "Auch beim Abspielen", "Aussi pendant la lecture", "También durante la reproducción",
        "播放时也更新", "再生中も更新",
    ),
    "Strength": ("Stärke", "Force", "Intensidad", "强度", "強さ"),
    "Reset Controls": (
        "Regler zurücksetzen", "Réinitialiser les contrôles", "Restablecer controles",
        "重置控制", "コントロールをリセット",
    ),
    "Mirror Expression": ("Ausdruck spiegeln", "Refléter l'expression", "Reflejar expresión", "镜像表情", "表情を反転"),
    "Random Expression": ("Zufälliger Ausdruck", "Expression aléatoire", "Expresión aleatoria", "随机表情", "ランダムな表情"),
    "Random Identity": (
        "Zufällige Identität", "Identité aléatoire", "Identidad aleatoria",
        "随机身份", "ランダムなアイデンティティ",
    ),
    "Make Independent": ("Unabhängig machen", "Rendre indépendant", "Hacer independiente", "使其独立", "独立させる"),
    "Direction": ("Richtung", "Direction", "Dirección", "方向", "方向"),
    "Region": ("Bereich", "Région", "Región", "区域", "領域"),
    "Seed": ("Startwert", "Graine", "Semilla", "种子", "シード"),
    "Amount": ("Menge", "Quantité", "Cantidad", "量", "量"),
    "Share": ("Anteil", "Part", "Proporción", "比例", "割合"),
    "Import Performance": (
        "Darbietung importieren", "Importer une performance", "Importar interpretación",
        "导入表演", "パフォーマンスをインポート",
    ),
    "Start Frame": ("Startbild", "Image de début", "Fotograma inicial", "起始帧", "開始フレーム"),
    "Keys": ("Keyframes", "Clés", "Claves", "关键帧", "キー"),
    "Gain": ("Verstärkung", "Gain", "Ganancia", "增益", "ゲイン"),
    "Smoothing": ("Glättung", "Lissage", "Suavizado", "平滑", "スムージング"),
    "Limit": ("Begrenzen", "Limiter", "Limitar", "限制", "制限"),
    "Head Rotation": ("Kopfdrehung", "Rotation de la tête", "Rotación de la cabeza", "头部旋转", "頭の回転"),
    "Eyes": ("Augen", "Yeux", "Ojos", "眼睛", "目"),
    "Set Scene Range": (
        "Szenenbereich setzen", "Définir la plage de la scène", "Definir rango de la escena",
        "设置场景范围", "シーン範囲を設定",
    ),
    "Poses": ("Posen", "Poses", "Poses", "姿态", "ポーズ"),
    "Pose Library": ("Posenbibliothek", "Bibliothèque de poses", "Biblioteca de poses", "姿态库", "ポーズライブラリ"),
    "Create Pose Library": (
        "Posenbibliothek anlegen", "Créer une bibliothèque de poses", "Crear biblioteca de poses",
        "创建姿态库", "ポーズライブラリを作成",
    ),
    "Draw Thumbnails Again": (
        "Vorschaubilder neu zeichnen", "Redessiner les vignettes", "Redibujar miniaturas",
        "重新绘制缩略图", "サムネイルを再描画",
    ),
    "Thumbnails": ("Vorschaubilder", "Vignettes", "Miniaturas", "缩略图", "サムネイル"),
    "Apply Pose": ("Pose anwenden", "Appliquer la pose", "Aplicar pose", "应用姿态", "ポーズを適用"),
    "Apply Pose by Name...": (
        "Pose nach Namen anwenden ...", "Appliquer une pose par nom...", "Aplicar pose por nombre...",
        "按名称应用姿态...", "名前でポーズを適用...",
    ),
    "Apply to GRMM Avatar": (
        "Auf GRMM-Avatar anwenden", "Appliquer à l'avatar GRMM", "Aplicar al avatar GRMM",
        "应用到 GRMM 化身", "GRMM アバターに適用",
    ),
    "Save Expression as Pose": (
        "Ausdruck als Pose sichern", "Enregistrer l'expression comme pose", "Guardar expresión como pose",
        "将表情保存为姿态", "表情をポーズとして保存",
    ),
    "Save Expression...": (
        "Ausdruck sichern ...", "Enregistrer l'expression...", "Guardar expresión...",
        "保存表情...", "表情を保存...",
    ),
    "Flip": ("Seiten tauschen", "Inverser", "Invertir", "翻转", "反転"),
    "Expression Presets": (
        "Ausdrucksvorgaben", "Préréglages d'expression", "Ajustes de expresión",
        "表情预设", "表情プリセット",
    ),
    "Render Presets": ("Rendervorgaben", "Préréglages de rendu", "Ajustes de procesado", "渲染预设", "レンダープリセット"),
    "Add Expression Preset": (
        "Ausdrucksvorgabe hinzufügen", "Ajouter un préréglage d'expression", "Añadir ajuste de expresión",
        "添加表情预设", "表情プリセットを追加",
    ),
    "Add Render Preset": (
        "Rendervorgabe hinzufügen", "Ajouter un préréglage de rendu", "Añadir ajuste de procesado",
        "添加渲染预设", "レンダープリセットを追加",
    ),
    "Pictures": ("Bilder", "Images", "Imágenes", "图片", "画像"),
    "Composite Avatars": (
        "Avatare einkomponieren", "Composer les avatars", "Componer avatares",
        "合成化身", "アバターを合成",
    ),
    "Remove Composite": ("Komposition entfernen", "Supprimer la composition", "Quitar composición", "移除合成", "合成を削除"),
    "Put Right": ("Richtigstellen", "Corriger", "Corregir", "修复", "修復"),
    "Turntable": ("Drehteller", "Plateau tournant", "Plataforma giratoria", "转台", "ターンテーブル"),
    "Frames": ("Bilder", "Images", "Fotogramas", "帧", "フレーム"),
    "Angle": ("Winkel", "Angle", "Ángulo", "角度", "角度"),
    "First Angle": ("Anfangswinkel", "Angle initial", "Ángulo inicial", "起始角度", "開始角度"),
    "Elevation": ("Höhenwinkel", "Élévation", "Elevación", "仰角", "仰角"),
    "Focal Length": ("Brennweite", "Focale", "Distancia focal", "焦距", "焦点距離"),
    "Margin": ("Rand", "Marge", "Margen", "边距", "余白"),
    "Contact Sheet": ("Kontaktbogen", "Planche-contact", "Hoja de contactos", "缩略图表", "コンタクトシート"),
    "Contact Sheet...": (
        "Kontaktbogen ...", "Planche-contact...", "Hoja de contactos...",
        "缩略图表...", "コンタクトシート...",
    ),
    "Content": ("Inhalt", "Contenu", "Contenido", "内容", "内容"),
    "Columns": ("Spalten", "Colonnes", "Columnas", "列", "列"),
    "Tiles": ("Kacheln", "Vignettes", "Recuadros", "格数", "タイル"),
    "Tile Size": ("Kachelgröße", "Taille des vignettes", "Tamaño de recuadro", "单格大小", "タイルサイズ"),
    "Captions": ("Beschriftung", "Légendes", "Leyendas", "标题", "キャプション"),
    "Background": ("Hintergrund", "Arrière-plan", "Fondo", "背景", "背景"),
    "Refine": ("Verfeinern", "Affiner", "Refinar", "精细化", "リファイン"),
    "Detail": ("Detail", "Détail", "Detalle", "细节", "ディテール"),
    "Scene Occludes": ("Szene verdeckt", "La scène occulte", "La escena oculta", "场景遮挡", "シーンが遮蔽"),
    "Edge Samples": ("Kanten-Samples", "Échantillons de bord", "Muestras de borde", "边缘采样", "エッジサンプル"),
    "Motion Steps": ("Bewegungsschritte", "Pas de mouvement", "Pasos de movimiento", "运动步数", "モーションステップ"),
    "Viewport": ("Ansicht", "Vue 3D", "Vista", "视图", "ビューポート"),
    "Film": ("Film", "Film", "Película", "胶片", "フィルム"),
    "Passes": ("Passes", "Passes", "Pases", "通道", "パス"),
    "Install Runtime": (
        "Laufzeit installieren", "Installer l'environnement d'exécution", "Instalar entorno de ejecución",
        "安装运行时", "ランタイムをインストール",
    ),
    "Copy Diagnostics": (
        "Diagnose kopieren", "Copier le diagnostic", "Copiar diagnóstico",
        "复制诊断信息", "診断情報をコピー",
    ),
    "No runtime installed": (
        "Keine Laufzeit installiert", "Aucun environnement installé", "Ningún entorno instalado",
        "未安装运行时", "ランタイムがインストールされていません",
    ),
}  # fmt: skip

CLASSES = ()


def table() -> dict[str, dict[tuple[str, str], str]]:
    """Return the messages as `bpy.app.translations` takes them: locale, then context and message."""
    return {
        locale: {(context, message): row[column] for message, row in MESSAGES.items() for context in CONTEXTS}
        for column, locale in enumerate(LOCALES)
    }


def register() -> None:
    """Hand the table to Blender."""
    bpy.app.translations.register(__name__, table())


def unregister() -> None:
    """Take it back."""
    bpy.app.translations.unregister(__name__)
